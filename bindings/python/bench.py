"""Correction and simulation from Python, the same calls in Rust and OpenCV, in one run, on one thread:

RAYON_NUM_THREADS=1 python bindings/python/bench.py

Rust and OpenCV run before and after. Cargo compiles the calls in Rust first.
"""

import os
import pathlib
import re
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable

import cv2
import numpy as np

import radcam


def clock(work: Callable[[], object], pixels: int, runs: int = 31) -> float:
    """Median nanoseconds a pixel."""
    work()
    times = []
    for _ in range(runs):
        begun = time.perf_counter()
        work()
        times.append((time.perf_counter() - begun) / pixels * 1e9)
    return statistics.median(times)


def rust() -> dict[str, float]:
    """Median nanoseconds a pixel of the benches in Rust."""
    root = pathlib.Path(__file__).parents[2]
    benches = ["--", "correct/to_(f32|u16)$|simulate/flat_5000_e$", "--warm-up-time", "1", "--measurement-time", "3", "--noplot"]
    done = subprocess.run(["cargo", "bench", "--bench", "frames", *benches], cwd=root, capture_output=True, text=True)
    if done.returncode != 0:
        raise SystemExit(done.stderr)
    unit = {"Melem/s": 1e3, "Gelem/s": 1.0}
    found = re.findall(r"(\w+/\w+)\s+time:.*?thrpt:\s+\[\S+ \S+ (\S+) (\S+) ", done.stdout, re.DOTALL)
    return {name: unit[u] / float(rate) for name, rate, u in found}


cv2.setNumThreads(int(os.environ.get("RAYON_NUM_THREADS", "0")) or os.cpu_count() or 1)
with tempfile.TemporaryDirectory() as folder:
    os.chdir(folder)
    base = radcam.Model.load("cmos12")
    rows, columns = 2048, 2448
    text = base.text.replace(f"width = {base.json()['camera']['width']}", f"width = {columns}")
    text = text.replace(f"height = {base.json()['camera']['height']}", f"height = {rows}")
    radcam.Model(text).save("large.toml")
    radcam.simulate("large.toml", "campaign", """
format = "radcam-plan/1"
about = "two darks, two flats"

[[set]]
kind = "dark"
frames = 4
exposure = 0.02
illumination = 0.0

[[set]]
kind = "dark"
frames = 4
exposure = 1.0
illumination = 0.0

[[set]]
kind = "flat"
frames = 4
exposure = 0.5
illumination = 1.0

[[set]]
kind = "flat"
frames = 4
exposure = 0.9
illumination = 1.0
""")
    calibration = radcam.calibrate("campaign", "cal.tiff", "smooth")
    corrector = calibration.corrector(0.004)
    frame = radcam.Sensor("large.toml").draw(1, 0.004)
    n = frame.size
    image, codes = np.empty(frame.shape, np.float32), np.empty_like(frame)
    dark, gain = calibration.dark_dn(0.004), 1 / calibration.k

    def opencv_f32() -> None:
        cv2.subtract(frame, dark, dst=image, dtype=cv2.CV_32F)
        cv2.multiply(image, gain, dst=image)

    def opencv_u16() -> None:
        cv2.subtract(frame, dark, dst=image, dtype=cv2.CV_32F)
        cv2.multiply(image, gain, dst=codes, scale=12.0, dtype=cv2.CV_16U)

    rust_before = rust()
    before = clock(opencv_f32, n), clock(opencv_u16, n)
    ours = clock(lambda: corrector.correct(frame, out=image), n), clock(lambda: corrector.correct_codes(frame, 12.0, 100.0, out=codes), n)
    in_place = clock(lambda: corrector.correct_codes(codes, 1.0, 100.0, out=codes), n)
    after = clock(opencv_f32, n), clock(opencv_u16, n)
    sensor = radcam.Sensor("cmos12")
    out = np.empty(sensor.shape, np.uint16)
    flux = base.json()["bench"]["photon_flux_per_s"] * base.json()["base"]["quantum_efficiency"]
    drawn = clock(lambda: sensor.draw(1, 5000 / flux, out=out), out.size)
    rust_after = rust()
    same = {name: (ns + rust_after[name]) / 2 for name, ns in rust_before.items()}
    print(f"Rust before and after: {rust_before}, {rust_after}")
    print("| call | Python, ns/px | Rust, ns/px | ratio | OpenCV, ns/px | ratio |\n| --- | --- | --- | --- | --- | --- |")
    names = (("correct", "correct/to_f32"), ("correct_codes", "correct/to_u16"))
    for (name, bench), mine, a, b in zip(names, ours, before, after, strict=True):
        print(f"| {name} | {mine:.3f} | {same[bench]:.3f} | {mine / same[bench]:.2f} | {(a + b) / 2:.3f} | {(a + b) / 2 / mine:.1f} |")
    print(f"| correct_codes in place | {in_place:.3f} | | | | |")
    print(f"| Sensor.draw at 5000 e | {drawn:.3f} | {same['simulate/flat_5000_e']:.3f} | {drawn / same['simulate/flat_5000_e']:.2f} | | |")
