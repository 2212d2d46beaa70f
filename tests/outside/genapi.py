"""A served camera seen by the reference implementation of GenApi (PyPI genicam), over GigE Vision's control protocol written here from the
standard: shares nothing with Aravis or radcam. Reads every feature, writes every number to its bounds and beyond, and checks what is read back.

    python3 tests/outside/genapi.py 127.0.0.1
"""
import re
import socket
import struct
import sys

from genicam import genapi


class Control:
    """GVCP: read and write memory, and keep control with the heartbeat that any command is."""

    def __init__(self, address):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.settimeout(2)
        self.address = (address, 3956)
        self.number = 0

    def ask(self, command, body):
        self.number = self.number % 0xFFFF + 1
        self.socket.sendto(struct.pack(">BBHHH", 0x42, 1, command, len(body), self.number) + body, self.address)
        while True:
            answer = self.socket.recv(2048)
            status, _, length, number = struct.unpack(">HHHH", answer[:8])
            if number == self.number:
                assert status == 0, f"command {command:#x}: status {status:#x}"
                return answer[8 : 8 + length]

    def read(self, at, length):
        out = b""
        while len(out) < length:
            # Whole words, 512 bytes at once.
            n = min(512, length - len(out))
            body = self.ask(0x84, struct.pack(">IHH", at + len(out), 0, (n + 3) // 4 * 4))
            out += body[4 : 4 + n]
        return out

    def write(self, at, data):
        self.ask(0x86, struct.pack(">I", at) + data)


class Port(genapi.AbstractPort):
    def __init__(self, control):
        super().__init__()
        self.control = control

    def is_open(self):
        return True

    def get_access_mode(self):
        return genapi.EAccessMode.RW

    def read(self, address, length):
        return self.control.read(address, length)

    def write(self, address, value):
        self.control.write(address, bytes(value))


def main():
    control = Control(sys.argv[1])
    control.write(0x0A00, struct.pack(">I", 2))  # control channel privilege
    url = control.read(0x0200, 512).split(b"\0")[0].decode()
    name, at, size = url.split(":")[1].split(";")
    text = control.read(int(at, 16), int(size, 16)).split(b"\0")[0].decode()

    nodes = genapi.NodeMap()
    nodes.load_xml_from_string(text)
    port = Port(control)
    nodes.connect(port, "Device")
    faults, read, written = [], 0, 0
    for name in sorted(set(re.findall("<pFeature>(.*?)</pFeature>", text))):
        node = nodes.get_node(name)
        if isinstance(node, (genapi.ICategory, genapi.ICommand)):
            continue
        read += 1
        if isinstance(node, genapi.IRegister):
            assert not node.get(node.length).strip(b"\0"), f"{name} is not empty"
            continue
        value = node.value
        numeric = isinstance(node, (genapi.IInteger, genapi.IFloat))
        if not numeric or node.get_access_mode() != genapi.EAccessMode.RW:
            continue
        low, high = node.min, node.max
        for wanted in (low, high):
            node.value = wanted
            if abs(node.value - wanted) > 1e-9 * abs(wanted):
                faults.append(f"{name}: {wanted} was written, and {node.value} is read")
            written += 1
        for beyond in (low - 1, high + 1):
            try:
                node.value = beyond
                faults.append(f"{name}: {beyond} was accepted; its bounds are {low} to {high}")
            except genapi.GenericException:
                pass
        node.value = value
    control.write(0x0A00, struct.pack(">I", 0))
    print(f"{read} features read, {written} bounds written")
    for fault in faults:
        print(fault)
    sys.exit(1 if faults or read < 25 or written < 20 else 0)


main()
