"""Correction and simulation from Python beside OpenCV, in one run, on one thread: RAYON_NUM_THREADS=1 python bindings/python/bench.py

The same calls in Rust: RAYON_NUM_THREADS=1 cargo bench --bench frames -- 'correct/to_|simulate/flat_5000_e$'
"""

import os
import statistics
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

    before = clock(opencv_f32, n), clock(opencv_u16, n)
    ours = clock(lambda: corrector.correct(frame, out=image), n), clock(lambda: corrector.correct_codes(frame, 12.0, 100.0, out=codes), n)
    in_place = clock(lambda: corrector.correct_codes(codes, 1.0, 100.0, out=codes), n)
    after = clock(opencv_f32, n), clock(opencv_u16, n)
    print("| call | ns/px | OpenCV, ns/px | ratio |\n| --- | --- | --- | --- |")
    for name, mine, a, b in zip(("correct", "correct_codes"), ours, before, after, strict=True):
        print(f"| {name} | {mine:.3f} | {(a + b) / 2:.3f} | {(a + b) / 2 / mine:.1f} |")
    print(f"| correct_codes in place | {in_place:.3f} | | |")
    sensor = radcam.Sensor("cmos12")
    out = np.empty(sensor.shape, np.uint16)
    flux = base.json()["bench"]["photon_flux_per_s"] * base.json()["base"]["quantum_efficiency"]
    print(f"| Sensor.draw at 5000 e | {clock(lambda: sensor.draw(1, 5000 / flux, out=out), out.size):.3f} | | |")
