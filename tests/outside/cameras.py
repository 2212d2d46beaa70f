"""Cameras of a generator that shares no code with radcam, each with one effect hidden in it, diagnosed by the program.

    python3 tests/outside/cameras.py --radcam target/release/radcam --out cameras --seeds 1,2,3 [--only NAME,...] [--strength 1]

needs numpy and tifffile. Prints a row for every camera: what was hidden, the error before and after, what was named. Ends with 1
where a name is wrong. The shapes of some effects differ from the program's own on purpose; `docs/CONFUSION.md` has the results.
"""

import argparse
import json
import pathlib
import subprocess
import sys

import numpy as np
import tifffile

SIZE, FULL, PEAK_S = 128, 4095, 0.02

# Kind, frames, exposure (s), light; frames of a set follow one another, each with 20 ms of read-out.
PLAN = (
    [("dark", 8, t, 0) for t in (1e-4, 0.02, 0.2, 1.0)]
    + [("flat", 8, PEAK_S, 0.5)]
    + [("flat", 8, t, 1) for t in (4e-4, 1.06e-3, 2.83e-3, 7.52e-3, 0.02, 0.005, 0.0075, 0.01, 0.0125, 0.015, 0.0175, 0.02)]
    + [("flat", 8, PEAK_S, light) for light in (0.5, 0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 1)]
    + [("flat", 4, PEAK_S, 1), ("dark", 4, PEAK_S, 0), ("scene", 8, PEAK_S, 1), ("scene", 8, 0.005, 1), ("flat", 8, PEAK_S, 0.5)]
)

# What is hidden, and the name that is right.
HIDDEN = {
    "clean": None,
    "brighter-fatter": "brighter-fatter",
    "interpixel-crosstalk": "interpixel-crosstalk",
    "readout-lowpass": "readout-lowpass",
    "sharpening, 3x3 box": "spatial-filter",
    "smoothing, 4 neighbours": "spatial-filter",
    "temporal-filter": "temporal-filter",
    "lag that is lagged again": "image-lag",
    "illumination-flicker": "illumination-flicker",
    "lamp that warms up": "illumination-drift",
    "lamp that drifts": "illumination-drift",
    "gain-drift": "gain-drift",
    "offset-drift": "offset-drift",
    "row-noise": "row-noise",
    "column-noise": "column-noise",
    "periodic-interference": "periodic-interference",
    "telegraph noise, fast": "random-telegraph-noise",
    "telegraph noise, slow": "random-telegraph-noise",
    "bit weights": "adc-nonlinearity",
    "charge-transfer-inefficiency": "charge-transfer-inefficiency",
    "smear": "smear",
    "exposure-offset": "exposure-offset",
    "full-well-saturation": "full-well-saturation",
    "black level too low": "black-clipping",
    "taps, halves": "tap-mismatch",
    "taps, odd rows": "tap-mismatch",
    "blooming": "blooming",
    "coarse-quantization": "coarse-quantization",
    "nonlinearity, square": "nonlinearity",
    "nonlinearity, cube": "nonlinearity",
}


def near(image):
    return sum(np.roll(image, s, a) for s in (1, -1) for a in (0, 1))


class Camera:
    """One camera: its constants are drawn from the seed and the name."""

    def __init__(self, name, seed, strength):
        r = self.r = np.random.default_rng(1000 * seed + sum(map(ord, name)))
        self.name, self.s = name, strength
        self.gain, self.read = r.uniform(0.14, 0.35), r.uniform(4, 9)
        self.black = r.uniform(60, 115)
        if name == "black level too low":
            self.black = r.uniform(0.5, 1.5) * self.read * self.gain
        y, x = np.mgrid[0:SIZE, 0:SIZE] / SIZE - 0.5
        self.k = 1 + r.uniform(0.004, 0.009) * r.standard_normal((SIZE, SIZE)) - 0.04 * (x**2 + y**2)
        self.offset = 0 if name == "black level too low" else r.normal(0, 1, (SIZE, SIZE))
        self.dark = r.uniform(5, 50) * r.gamma(8, 1 / 8, (SIZE, SIZE)) * np.where(r.random((SIZE, SIZE)) < 5e-4, 20, 1)
        self.peak = 0.9 * (FULL - self.black) / self.gain
        self.scene = np.full((SIZE, SIZE), 0.1)
        self.scene[56:80, 56:80] = 0.8
        self.jumpy, self.up = r.random((SIZE, SIZE)) < 0.008, r.random((SIZE, SIZE)) < 0.5
        self.tap = r.choice([-1, 1], 2) * r.uniform(0.5, 1, 2) * (0.006, 3)
        self.line = r.uniform(0.02, 0.48)
        # Widths stay positive: five bits together are off by less than a code.
        self.bits = np.concatenate([[0], r.uniform(-0.19, 0.19, 5), np.zeros(6)])
        self.held = self.last = 0

    def frame(self, kind, exposure, light, t):
        r, s, n = self.r, self.s, self.name
        rate = self.peak / PEAK_S * light * (self.scene if kind == "scene" else 1) * self.k
        if n == "illumination-flicker":
            rate = rate * (1 + 0.004 * s * r.standard_normal())
        if n == "lamp that warms up":
            rate = rate * (1 - 0.02 * s * np.exp(-t / 8))
        if n == "lamp that drifts":
            rate = rate * (1 + 0.001 * s * t)
        charge = rate * (exposure + (3e-5 * s if n == "exposure-offset" else 0)) + self.dark * exposure
        if n == "smear":
            charge = charge + 2e-5 * s * np.broadcast_to(rate, (SIZE, SIZE)).mean(0)
        q = self.collect(charge)
        q = q + self.read * r.standard_normal((SIZE, SIZE))
        if n == "row-noise":
            q += s * r.standard_normal((SIZE, 1))
        if n == "column-noise":
            q += s * r.standard_normal((1, SIZE))
        if n.startswith("telegraph"):
            self.up ^= r.random((SIZE, SIZE)) < (0.5 if "fast" in n else 0.15)
            q += 45 * s * self.jumpy * self.up
        if n == "readout-lowpass":
            for x in range(1, SIZE):
                q[:, x] = (1 - 0.02 * s) * q[:, x] + 0.02 * s * q[:, x - 1]
        return self.convert(self.gain * q, t)

    def collect(self, charge):
        r, s, n = self.r, self.s, self.name
        if n == "brighter-fatter":
            q = np.zeros((SIZE, SIZE))
            for _ in range(16):
                pull = 2.5e-6 * s * (np.roll(q, 1, 0) + np.roll(q, -1, 0) - 2 * q)
                pull += 1.5e-6 * s * (np.roll(q, 1, 1) + np.roll(q, -1, 1) - 2 * q)
                q += r.poisson(np.maximum(charge / 16 * (1 + pull), 0))
            return q
        q = r.poisson(charge).astype(float)
        if n == "full-well-saturation":
            q = np.minimum(q, 0.75 * self.peak)
        if n == "blooming":
            well = 0.75 * self.peak
            for _ in range(60):
                over = np.maximum(q - well, 0)
                q -= over
                q[1:] += 0.5 * over[:-1]
                q[:-1] += 0.5 * over[1:]
            q = np.minimum(q, well)
        if n == "interpixel-crosstalk":
            q = (1 - 0.024 * s) * q + 0.006 * s * near(q)
        if n.startswith("lag"):
            q = q + self.held
            self.held = 0.004 * s * q
            q = q - self.held
        if n == "charge-transfer-inefficiency":
            share, out = 5e-5 * s, np.empty_like(q)
            for row in range(SIZE):
                out[row] = (1 - share) * q[0]
                q = np.vstack([(1 - share) * q[1:], np.zeros((1, SIZE))]) + share * q
            q = out
        return q

    def convert(self, v, t):
        r, s, n = self.r, self.s, self.name
        if n == "gain-drift":
            v = v * (1 + 0.001 * s * t)
        if n.startswith("nonlinearity"):
            v = v * (1 - 0.005 * s * (v / FULL if "square" in n else (v / FULL) ** 2))
        if n.startswith("taps"):
            part = np.s_[:, SIZE // 2 :] if "halves" in n else np.s_[1::2]
            v[part] = v[part] * (1 + s * self.tap[0]) + s * self.tap[1]
        v = v + self.black + self.offset
        if n == "offset-drift":
            v = v + 0.05 * s * t
        if n == "periodic-interference":
            place = np.arange(SIZE * SIZE).reshape(SIZE, SIZE)
            v = v + 0.8 * s * np.sin(2 * np.pi * (self.line * place + r.random()))
        if n == "temporal-filter":
            v = v if np.ndim(self.last) == 0 else (1 - 0.08 * s) * v + 0.08 * s * self.last
            self.last = v
        if n.startswith("sharpening"):
            box = sum(np.roll(v, (a, b), (0, 1)) for a in (-1, 0, 1) for b in (-1, 0, 1)) / 9
            v = v + 0.05 * s * (v - box)
        if n.startswith("smoothing"):
            v = (1 - 0.04 * s) * v + 0.01 * s * near(v)
        if n == "bit weights":
            level = ((np.arange(FULL + 1)[:, None] >> np.arange(12) & 1) * (2.0 ** np.arange(12) + s * self.bits)).sum(1)
            code = np.searchsorted(level[1:] - 0.5, v)
        else:
            code = 4 * np.round(v / 4) if n == "coarse-quantization" else np.round(v)
        return np.clip(code, 0, FULL).astype(np.uint16)


def draw(folder, name, seed, strength):
    camera, t, rows = Camera(name, seed, strength), 0.0, []
    (folder / "frames").mkdir(parents=True, exist_ok=True)
    for number, (kind, frames, exposure, light) in enumerate(PLAN):
        for index in range(frames):
            file = f"frames/{len(rows):05}.tiff"
            tifffile.imwrite(folder / file, camera.frame(kind, exposure, light, t))
            rows.append(f"{file},{kind},{number},{index},{exposure:g},{light:g},0,,{t:.6f}")
            t += exposure + 0.02
    header = "file,kind,set,index,exposure_s,illumination,configuration,temperature_c,timestamp_s"
    (folder / "frames.csv").write_text("\n".join([header, *rows]) + "\n")
    (folder / "dataset.toml").write_text(
        f'format = "radcam-dataset/1"\n\n[camera]\nvendor = "outside"\nmodel = "{name}"\nserial = "{seed}"\n'
        f'width = {SIZE}\nheight = {SIZE}\nbit_depth = 12\npixel_format = "Mono12"\n'
    )


def main():
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--radcam", default="target/release/radcam")
    ask.add_argument("--out", type=pathlib.Path, required=True)
    ask.add_argument("--seeds", default="1")
    ask.add_argument("--only", default=",".join(n.replace(",", "") for n in HIDDEN))
    ask.add_argument("--strength", type=float, default=1.0)
    said = ask.parse_args()
    wrong = 0
    for seed in map(int, said.seeds.split(",")):
        for name, right in HIDDEN.items():
            if name.replace(",", "") not in said.only.split(","):
                continue
            folder = said.out / f"{name.replace(',', '').replace(' ', '-')}-{seed}-{said.strength:g}"
            if not (folder / "dataset.toml").exists():
                draw(folder, name, seed, said.strength)
            out = subprocess.run([said.radcam, "diagnose", folder, "--json"], capture_output=True, text=True)
            answer = json.loads(out.stdout) if out.returncode in (0, 1) else sys.exit(out.stderr)
            named = [m["effect"] for m in answer["missing"]]
            ties = [m["effect"] for m in answer["missing"][1:2] if "a tie with" in str(m["evidence"])]
            good = right in named[:1] + ties if right else not named
            wrong += not good
            print(
                f"{name:30} {seed:3}  {answer['error_before']:8.2f} -> {answer['error_after']:.3f}  {'' if good else 'WRONG '}"
                f"{', '.join(named) or 'consistent'}",
                flush=True,
            )
    print(f"{wrong} wrong")
    sys.exit(wrong > 0)


if __name__ == "__main__":
    main()
