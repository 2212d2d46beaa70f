#!/usr/bin/env python3
"""A network between two namespaces that loses, doubles, reorders or changes packets, or is cut.

    network.py CAMERA CLIENT

makes the network namespaces CAMERA (10.77.0.1) and CLIENT (10.77.0.2) and joins them by two TAP devices whose Ethernet frames pass through
here. It answers "ready", then obeys lines on standard input and answers each with "ok":

    lose P | double P | reorder P | change P    share of stream packets to which that is done, 0 to 1
    cut | join                                  nothing passes; everything passes

Stream packets are those of UDP that go to CLIENT and do not come from the control port. A changed packet keeps its checksums: they no longer
fit, as after a fault in a cable or a switch. Ends with standard input, and removes the namespaces.
"""
import ctypes
import fcntl
import os
import random
import select
import struct
import subprocess
import sys

TUNSETIFF, TAP, NO_INFO = 0x400454CA, 0x0002, 0x1000
CONTROL_PORT = 3956
CLONE_NEWNET = 0x40000000


def tap(namespace, name, address):
    """A TAP device in a namespace, as a file descriptor."""
    here = os.open("/proc/self/ns/net", os.O_RDONLY)
    there = os.open(f"/run/netns/{namespace}", os.O_RDONLY)
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.setns(there, CLONE_NEWNET):
        raise OSError(ctypes.get_errno(), "setns")
    device = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(device, TUNSETIFF, struct.pack("16sH22x", name.encode(), TAP | NO_INFO))
    libc.setns(here, CLONE_NEWNET)
    for command in (f"addr add {address}/24 dev {name}", f"link set {name} up txqueuelen 10000", "link set lo up"):
        subprocess.run(["ip", "-n", namespace, *command.split()], check=True)
    os.close(here), os.close(there)
    return device


def is_stream(frame):
    """UDP over IPv4 that does not come from the control port."""
    return (len(frame) > 42 and frame[12:14] == b"\x08\x00" and frame[23] == 17
            and struct.unpack_from("!H", frame, 34)[0] != CONTROL_PORT)


def main(camera, client):
    for namespace in (camera, client):
        subprocess.run(["ip", "netns", "add", namespace], check=True)
    try:
        devices = {tap(camera, "tap0", "10.77.0.1"): True, tap(client, "tap0", "10.77.0.2"): False}
        forward(devices)
    finally:
        for namespace in (camera, client):
            subprocess.run(["ip", "netns", "del", namespace], check=False)


def forward(devices):
    share = dict.fromkeys(("lose", "double", "reorder", "change"), 0.0)
    cut, held, dice, typed = False, None, random.Random(1), ""
    commands = sys.stdin.fileno()
    other = dict(zip(devices, reversed(list(devices))))
    done = dict.fromkeys(share, 0)
    print("ready", flush=True)
    while True:
        ready, _, _ = select.select([commands, *devices], [], [], 0.002)
        if commands in ready:
            text = os.read(commands, 4096).decode()
            if not text:
                return
            *lines, typed = (typed + text).split("\n")
            for line in lines:
                word, *value = line.split()
                if word in share:
                    share[word] = float(value[0])
                elif word == "done":
                    print(" ".join(f"{k}={v}" for k, v in done.items()), flush=True)
                    continue
                else:
                    cut = word == "cut"
                print("ok", flush=True)
        if held and not any(d in ready for d in devices):
            send(*held)
            held = None
        for device, from_camera in devices.items():
            if device not in ready:
                continue
            # Some at a time: the other direction and the commands are not kept waiting.
            for _ in range(64):
                try:
                    frame = os.read(device, 65536)
                except BlockingIOError:
                    break
                if cut:
                    continue
                to = other[device]
                if not (from_camera and is_stream(frame)):
                    send(to, frame)
                    continue
                if dice.random() < share["lose"]:
                    done["lose"] += 1
                    continue
                if dice.random() < share["change"]:
                    done["change"] += 1
                    # Behind the headers of Ethernet, IP, UDP and of the stream protocol.
                    at = dice.randrange(50, len(frame)) if len(frame) > 51 else len(frame) - 1
                    frame = frame[:at] + bytes([frame[at] ^ dice.randrange(1, 256)]) + frame[at + 1:]
                if held is None and dice.random() < share["reorder"]:
                    done["reorder"] += 1
                    held = (to, frame)
                    continue
                send(to, frame)
                if held:
                    send(*held)
                    held = None
                if dice.random() < share["double"]:
                    done["double"] += 1
                    send(to, frame)


def send(device, frame):
    try:
        os.write(device, frame)
    except (BlockingIOError, OSError):
        pass  # as a full queue loses it


if __name__ == "__main__":
    main(*sys.argv[1:])
