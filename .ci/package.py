"""Packages what is published and compares each package with what the compiler read of it: no file may be missing.

The first argument is the list of files that cargo writes beside the program, `target/debug/radcam.d`; others are options of `cargo package`.
"""
import pathlib, re, subprocess, sys

root = pathlib.Path(__file__).resolve().parent.parent
listed = pathlib.Path(sys.argv[1]).resolve()
read = listed.read_text().split(": ", 1)[1]
read = {pathlib.Path(p.replace("\\ ", " ")) for p in re.split(r"(?<!\\) ", read.strip())}
others = ["--exclude", "row-gain-noise", "--exclude", "radcam-python"]
subprocess.run(["cargo", "package", "--workspace", *others, "--quiet", "--no-verify", *sys.argv[2:]], cwd=root, check=True)
# Files that build scripts wrote lie beside the program.
missing = {p for p in read if root in p.parents and listed.parent not in p.parents}
counts = {}
for package, folder in [("radcam-sim", "sim"), ("radcam-aravis", "bindings/aravis"), ("radcam", ".")]:
    command = ["cargo", "package", "--list", "-p", package, *sys.argv[2:]]
    names = subprocess.run(command, cwd=root, check=True, capture_output=True, text=True).stdout.splitlines()
    own = {(root / folder / name).resolve() for name in names}
    counts[package] = len(missing & own)
    missing -= own
if missing or not all(counts.values()):
    sys.exit("packages have no file of these, which the program is compiled from: %s (%s)" % (sorted(map(str, missing)), counts))
print("packages are complete:", counts)
