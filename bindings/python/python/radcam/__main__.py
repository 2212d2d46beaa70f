"""The program `radcam`."""

import signal
import sys

from radcam import _radcam


def main() -> int:
    """Runs the program with the arguments of the process."""
    # The program handles Ctrl-C itself: it ends what it does in order.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    return _radcam.main(["radcam", *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
