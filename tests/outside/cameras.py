"""Simulated cameras of a generator that shares no code with radcam, each with one effect in it, diagnosed by the program.

    cameras.py --radcam PATH --out DIR --seeds 1,2 [--only KIND,...] [--strength F] [--keep]   a line for every camera
    cameras.py --radcam PATH --out DIR --campaign N [--first-seed S] [--rows FILE]             N cameras, then a table
    cameras.py --radcam PATH --out DIR --quick                                                 twenty-two cameras, for CI
    cameras.py --list                                                                          the kinds, as a table
    cameras.py --table FILE                                                                    the table of recorded rows

Needs numpy and tifffile. A kind is one of three groups. Catalogue: its effect has an identifier, and that name must stand first.
Clean: nothing must be named. Outside: its effect has no identifier, and `unknown` must stand first; `near` holds the identifiers
whose physics is nearest (it may be empty). The strength s of a kind is drawn log-uniform from a range that goes from barely visible
to plain. Commas in names are left out on the command line. Ends with 1 where a wrong name stands first, with 2 where a run failed.

Signal chain and stages, in order. A kind acts at one stage; x is the stage's input, f the frame, N a standard normal number:
light (rate of charge, e/s) - charge (mean charge, e) - collect (shot noise) - stored (e, before read noise) - noise (the read
noise itself, e) - read (e, with read noise) - amplifier (DN above black) - black (DN with black level) - adc (to codes) - digital
(codes; rounded and clipped after the stage). Axis 0 of an image is the row number, axis 1 the column number.
"""

import argparse
import dataclasses
import json
import pathlib
import shutil
import subprocess
import sys
import time
import zlib

import numpy as np
import tifffile

FULL, PEAK_S, GAP_S = 4095, 0.02, 0.02

# Kind, frames, exposure (s), light. Frames follow one another, each with GAP_S of read-out.
PLAN = (
    [("dark", 8, t, 0) for t in (1e-4, 0.02, 0.2, 1.0)]
    + [("flat", 8, PEAK_S, 0.5)]
    + [("flat", 8, t, 1) for t in (4e-4, 1.06e-3, 2.83e-3, 7.52e-3, 0.02, 0.005, 0.0075, 0.01, 0.0125, 0.015, 0.0175, 0.02)]
    + [("flat", 8, PEAK_S, light) for light in (0.5, 0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 1)]
    + [("flat", 4, PEAK_S, 1), ("dark", 4, PEAK_S, 0), ("scene", 8, PEAK_S, 1), ("scene", 8, 0.005, 1), ("flat", 8, PEAK_S, 0.5)]
)
CLEAN, OUTSIDE = "clean", "outside"
KINDS = {}


@dataclasses.dataclass
class Kind:
    name: str
    truth: str  # an identifier of the catalogue, CLEAN or OUTSIDE
    span: tuple  # smallest and largest strength
    unit: str
    stage: str
    near: tuple
    act: callable

    @property
    def key(self):
        return self.name.replace(",", "")

    @property
    def group(self):
        return self.truth if self.truth in (CLEAN, OUTSIDE) else "catalogue"


@dataclasses.dataclass
class Frame:
    kind: str
    exposure: float
    light: float
    t: float
    set: int  # -1 for frames before the first recorded one
    index: int
    number: int
    rate: np.ndarray = None


def kind(name, truth, span, unit, stage, near=""):
    def add(act):
        KINDS[name] = Kind(name, truth, span, unit, stage, tuple(near.split()), act)
        return act

    return add


class Camera:
    """One camera. All constants are drawn from the seed and the name of the kind."""

    def __init__(self, what, seed, size, place=None):
        self.kind, self.n, self.memory = what, size, {}
        r = self.r = np.random.default_rng([seed, zlib.crc32(what.name.encode())])
        drawn = r.random()
        low, high = what.span
        self.s = low * (high / low) ** (drawn if place is None else place)
        self.gain, self.read = r.uniform(0.14, 0.35), r.uniform(4, 9)
        self.black = r.uniform(60, 115)
        y, x = np.mgrid[0:size, 0:size] / size - 0.5
        self.k = 1 + r.uniform(0.004, 0.009) * r.standard_normal((size, size)) - 0.04 * (x**2 + y**2)
        self.offset = r.normal(0, 1, (size, size))
        self.dark = r.uniform(5, 50) * r.gamma(8, 1 / 8, (size, size)) * np.where(r.random((size, size)) < 5e-4, 20, 1)
        self.peak = 0.9 * (FULL - self.black) / self.gain
        self.scene = np.full((size, size), 0.1)
        self.scene[7 * size // 16 : 5 * size // 8, 7 * size // 16 : 5 * size // 8] = 0.8
        self.past = int(r.integers(0, 3))
        self.stage("constants", None, None)

    def once(self, name, draw):
        """A constant of the kind: drawn at first use, kept from then on. `draw` gets the random generator."""
        if name not in self.memory:
            self.memory[name] = draw(self.r)
        return self.memory[name]

    def normal(self, *shape):
        return self.r.standard_normal(shape)

    def stage(self, name, x, f):
        return self.kind.act(self, x, f) if self.kind.stage == name else x

    def frame(self, f):
        rate = self.peak / PEAK_S * f.light * (self.scene if f.kind == "scene" else 1) * self.k
        f.rate = self.stage("light", rate, f)
        charge = self.stage("charge", f.rate * f.exposure + self.dark * f.exposure, f)
        q = self.stage("collect", charge, f) if self.kind.stage == "collect" else self.r.poisson(charge).astype(float)
        q = self.stage("stored", q, f)
        q = self.stage("read", q + self.stage("noise", self.read * self.normal(self.n, self.n), f), f)
        v = self.stage("amplifier", self.gain * q, f)
        v = self.stage("black", v + self.black + self.offset, f)
        code = self.stage("adc", v, f) if self.kind.stage == "adc" else np.round(v)
        code = self.stage("digital", np.clip(code, 0, FULL), f)
        return np.clip(np.floor(code + 0.5), 0, FULL).astype(np.uint16)


def near4(image):
    """Sum of the four nearest neighbours, wrapping at the border."""
    return sum(np.roll(image, s, a) for s in (1, -1) for a in (0, 1))


def box9(image, reduce=np.mean):
    """Mean (or another number) of the 3x3 box around every pixel, wrapping at the border."""
    return reduce([np.roll(image, (a, b), (0, 1)) for a in (-1, 0, 1) for b in (-1, 0, 1)], axis=0)


def wander(c):
    """A random series down the rows, of unit variance: AR(1), or with a spectrum of 1/f, as drawn for the camera."""
    rho = c.once("rho", lambda r: r.choice([0, r.uniform(0.9, 0.98)]))
    if rho:
        w = c.normal(c.n)
        for y in range(1, c.n):
            w[y] = rho * w[y - 1] + np.sqrt(1 - rho**2) * w[y]
        return w[:, None]
    size = 4 * c.n
    amplitude = np.fft.rfftfreq(size)[1:] ** -0.5
    spectrum = np.concatenate([[0], amplitude * (c.normal(amplitude.size) + 1j * c.normal(amplitude.size))])
    return (np.fft.irfft(spectrum) * size / 2 / np.sqrt((amplitude**2).sum()))[: c.n, None]


def traps(c, q, taus):
    """Pool i takes f_i q and gives back the share 1 - exp(-dt / tau_i) of what it holds; dt is the time of a frame, sum f_i = s."""
    share = c.once("share", lambda r: r.dirichlet(np.full(len(taus), 4.0)))
    tau = c.once("tau", lambda r: [r.uniform(*t) for t in taus])
    held = c.once("held", lambda _: [0.0] * len(taus))
    out = q * (1 - c.s)
    for i, t in enumerate(tau):
        freed = held[i] * (1 - np.exp(-c.step / t))
        held[i] = held[i] - freed + c.s * share[i] * q
        out = out + freed
    return out


# ---- Catalogue: the light ------------------------------------------------------------------------------------------------------


@kind("illumination-flicker", "illumination-flicker", (0.0005, 0.005), "1", "light")
def flicker(c, x, f):
    """Light of each frame times 1 + s N."""
    return x * (1 + c.s * c.r.standard_normal())


@kind("lamp that warms up", "illumination-drift", (0.003, 0.03), "1", "light")
def warm_up(c, x, f):
    """Light times 1 - s exp(-t / 8 s)."""
    return x * (1 - c.s * np.exp(-f.t / 8))


@kind("lamp that drifts", "illumination-drift", (0.0002, 0.002), "1/s", "light")
def lamp_drift(c, x, f):
    """Light times 1 + s t."""
    return x * (1 + c.s * f.t)


@kind("lamp set anew", "illumination-setting", (0.001, 0.01), "1", "light")
def lamp_setting(c, x, f):
    """Light times 1 + s N, one N for all frames of a set."""
    return x * (1 + c.s * c.once(("set", f.set), lambda r: r.standard_normal()))


@kind("light bands, sine", "light-banding", (0.002, 0.02), "1", "light")
def bands_sine(c, x, f):
    """Rolling shutter: light of row y times 1 + s sinc(F T) sin(2 pi (F y tau + phase)), T the exposure, phase new each frame."""
    ripple = c.once("ripple", lambda r: r.choice([100.0, 120.0, r.uniform(60, 260)]))
    waves = c.once("waves", lambda r: r.uniform(0.4, 4))  # F tau times the number of rows
    row = np.arange(c.n)[:, None] / c.n
    return x * (1 + c.s * np.sinc(ripple * f.exposure) * np.sin(2 * np.pi * (waves * row + c.r.random())))


@kind("light bands, wander", "light-banding", (0.0002, 0.002), "1", "light")
def bands_wander(c, x, f):
    """Light of row y times 1 + s w(y); w is a slow random series (AR(1) or 1/f) drawn anew each frame."""
    return x * (1 + c.s * wander(c))


@kind("stray-light", "stray-light", (0.003, 0.03), "1", "light")
def stray(c, x, f):
    """Light of each pixel becomes (1 - s) light + s (mean light of the frame); the pixel's response is applied after it."""
    light = x / c.k
    return c.k * ((1 - c.s) * light + c.s * light.mean())


# ---- Catalogue: the charge -----------------------------------------------------------------------------------------------------


@kind("exposure-offset", "exposure-offset", (6e-6, 6e-5), "s", "charge")
def exposure_offset(c, x, f):
    """Charge + rate s: the shutter is open for T + s."""
    return x + f.rate * c.s


@kind("smear", "smear", (3e-6, 3e-5), "s", "charge")
def smear(c, x, f):
    """Charge + s (mean rate of the pixel's column), at any exposure."""
    return x + c.s * f.rate.mean(0)


@kind("dark-current-drift", "dark-current-drift", (0.01, 0.1), "1/s", "charge")
def dark_drift(c, x, f):
    """Dark charge becomes dark T (1 + s t)."""
    return x + c.dark * f.exposure * c.s * max(f.t, 0)


@kind("brighter-fatter", "brighter-fatter", (5e-7, 5e-6), "1/e", "collect")
def brighter_fatter(c, x, f):
    """Charge arrives in 8 steps, each times 1 + s (q_up + q_down - 2q) + 0.6 s (q_left + q_right - 2q), q the charge so far."""
    q = np.zeros_like(x)
    for _ in range(8):
        pull = sum(w * (np.roll(q, 1, a) + np.roll(q, -1, a) - 2 * q) for a, w in ((0, c.s), (1, 0.6 * c.s)))
        q += c.r.poisson(np.maximum(x / 8 * (1 + pull), 0))
    return q


@kind("full-well-saturation", "full-well-saturation", (0.05, 0.5), "1", "stored")
def full_well(c, q, f):
    """min(q, (1 - s) q_peak)."""
    return np.minimum(q, (1 - c.s) * c.peak)


@kind("blooming", "blooming", (0.04, 0.4), "1", "stored")
def blooming(c, q, f):
    """Charge above the well (1 - s) q_peak goes to the pixels above and below, half each, until all fits or 60 steps are done."""
    well = (1 - c.s) * c.peak
    for _ in range(60):
        over = np.maximum(q - well, 0)
        q = q - over
        q[1:] += 0.5 * over[:-1]
        q[:-1] += 0.5 * over[1:]
    return np.minimum(q, well)


@kind("interpixel-crosstalk", "interpixel-crosstalk", (0.001, 0.01), "1", "stored")
def crosstalk(c, q, f):
    """(1 - 4 s) q + s (sum of the four neighbours), after the shot noise."""
    return (1 - 4 * c.s) * q + c.s * near4(q)


@kind("lag that is lagged again", "image-lag", (0.002, 0.02), "1", "stored")
def lag_lagged(c, q, f):
    """p = q + held; the new held is s p; out = p - s p."""
    q = q + c.memory.get("held", 0)
    c.memory["held"] = c.s * q
    return (1 - c.s) * q


@kind("lag, two times", "image-lag", (0.003, 0.03), "1", "stored")
def lag_two(c, q, f):
    """Two pools of traps with tau of 20-60 ms and 0.1-0.5 s, see `traps`."""
    return traps(c, q, ((0.02, 0.06), (0.1, 0.5)))


@kind("lag, three times", "image-lag", (0.003, 0.03), "1", "stored")
def lag_three(c, q, f):
    """Three pools of traps with tau of 15-40 ms, 0.08-0.3 s and 0.6-2 s, see `traps`."""
    return traps(c, q, ((0.015, 0.04), (0.08, 0.3), (0.6, 2)))


@kind("charge-transfer-inefficiency", "charge-transfer-inefficiency", (4e-5, 4e-4), "1", "stored")
def transfer(c, q, f):
    """In each of y + 1 transfers a packet of row y leaves the share s behind, which joins the next packet."""
    out = np.empty_like(q)
    for row in range(c.n):
        out[row] = (1 - c.s) * q[0]
        q = c.s * q + (1 - c.s) * np.vstack([q[1:], np.zeros((1, c.n))])
    return out


def filling(c, q, axis):
    """Traps met in m transfers hold C(q) = m s q / (1 + q / q0); out = q - C(q) + C(q of the packet before), m = place + 1."""
    fill = c.once("fill", lambda r: r.uniform(0.05, 0.3)) * c.peak
    transfers = np.arange(1, c.n + 1).reshape((-1, 1) if axis == 0 else (1, -1))
    caught = transfers * c.s * q / (1 + q / fill)
    before = np.roll(caught, 1, axis)
    before[(0,) if axis == 0 else (slice(None), 0)] = 0
    return q - caught + before


@kind("transfer, traps that fill, parallel", "charge-transfer-inefficiency", (1e-4, 1e-3), "1", "stored")
def transfer_parallel(c, q, f):
    """Down the columns, see `filling`; q0 = 0.05-0.3 q_peak."""
    return filling(c, q, 0)


@kind("transfer, traps that fill, serial", "charge-transfer-inefficiency", (1e-4, 1e-3), "1", "stored")
def transfer_serial(c, q, f):
    """Along the rows, see `filling`; q0 = 0.05-0.3 q_peak."""
    return filling(c, q, 1)


# ---- Catalogue: read-out, amplifier, black level -------------------------------------------------------------------------------


@kind("row-noise", "row-noise", (0.2, 2), "e", "read")
def row_noise(c, q, f):
    """q + s N(row)."""
    return q + c.s * c.normal(c.n, 1)


@kind("column-noise", "column-noise", (0.2, 2), "e", "read")
def column_noise(c, q, f):
    """q + s N(column)."""
    return q + c.s * c.normal(1, c.n)


def telegraph(c, q, chance):
    """A share 0.008 of the pixels: q + s b, b is 0 or 1 and changes between frames with the given chance."""
    jumpy = c.once("jumpy", lambda r: r.random(q.shape) < 0.008)
    up = c.memory["up"] = c.once("up", lambda r: r.random(q.shape) < 0.5) ^ (c.r.random(q.shape) < chance)
    return q + c.s * jumpy * up


@kind("telegraph noise, fast", "random-telegraph-noise", (15, 150), "e", "read")
def telegraph_fast(c, q, f):
    """See `telegraph`, chance 0.5."""
    return telegraph(c, q, 0.5)


@kind("telegraph noise, slow", "random-telegraph-noise", (15, 150), "e", "read")
def telegraph_slow(c, q, f):
    """See `telegraph`, chance 0.15."""
    return telegraph(c, q, 0.15)


@kind("readout-lowpass", "readout-lowpass", (0.003, 0.03), "1", "read")
def lowpass(c, q, f):
    """out(x) = (1 - s) q(x) + s out(x - 1) along the row."""
    q = q.copy()
    for x in range(1, c.n):
        q[:, x] = (1 - c.s) * q[:, x] + c.s * q[:, x - 1]
    return q


@kind("column-gain-noise", "column-gain-noise", (0.0002, 0.002), "1", "amplifier")
def column_gain(c, v, f):
    """v (1 + s N(column))."""
    return v * (1 + c.s * c.normal(1, c.n))


@kind("gain-drift", "gain-drift", (0.0002, 0.002), "1/s", "amplifier")
def gain_drift(c, v, f):
    """v (1 + s t)."""
    return v * (1 + c.s * f.t)


@kind("nonlinearity, square", "nonlinearity", (0.003, 0.03), "1", "amplifier")
def bend_square(c, v, f):
    """v (1 - s v / 4095)."""
    return v * (1 - c.s * v / FULL)


@kind("nonlinearity, cube", "nonlinearity", (0.003, 0.03), "1", "amplifier")
def bend_cube(c, v, f):
    """v (1 - s (v / 4095)^2)."""
    return v * (1 - c.s * (v / FULL) ** 2)


@kind("nonlinearity, power law", "nonlinearity", (0.004, 0.05), "1", "amplifier")
def bend_power(c, v, f):
    """4095 sign(v) (|v| / 4095)^(1 - s)."""
    return FULL * np.sign(v) * (np.abs(v) / FULL) ** (1 - c.s)


@kind("nonlinearity, two slopes", "nonlinearity", (0.012, 0.15), "1", "amplifier")
def bend_knee(c, v, f):
    """v up to a knee at 0.3-0.7 of 4095, slope 1 - s above it."""
    knee = c.once("knee", lambda r: r.uniform(0.3, 0.7)) * FULL
    return v - c.s * np.maximum(v - knee, 0)


@kind("nonlinearity, asymptote", "nonlinearity", (0.005, 0.05), "1", "amplifier")
def bend_asymptote(c, v, f):
    """v / (1 + s v / 4095): goes towards 4095 / s."""
    return v / (1 + c.s * v / FULL)


@kind("nonlinearity, S-shaped", "nonlinearity", (0.004, 0.04), "1", "amplifier")
def bend_s(c, v, f):
    """v + (s / 2 pi) 4095 sin(2 pi v / 4095)."""
    return v + c.s * FULL / (2 * np.pi) * np.sin(2 * np.pi * v / FULL)


def taps(c, v, part):
    """In one part of the image v (1 + s g) + s o; g = +-(0.003-0.006), o = +-(1.5-3) DN."""
    g, o = c.once("tap", lambda r: r.choice([-1, 1], 2) * r.uniform(0.5, 1, 2) * (0.006, 3))
    v = v.copy()
    v[part] = v[part] * (1 + c.s * g) + c.s * o
    return v


@kind("taps, halves", "tap-mismatch", (0.15, 1.5), "1", "amplifier")
def taps_halves(c, v, f):
    """The right half, see `taps`."""
    return taps(c, v, np.s_[:, c.n // 2 :])


@kind("taps, odd rows", "tap-mismatch", (0.15, 1.5), "1", "amplifier")
def taps_rows(c, v, f):
    """The odd rows, see `taps`."""
    return taps(c, v, np.s_[1::2])


@kind("offset-drift", "offset-drift", (0.008, 0.08), "DN/s", "black")
def offset_drift(c, v, f):
    """v + s t."""
    return v + c.s * f.t


@kind("black level too low", "black-clipping", (0.6, 2), "1", "constants")
def black_low(c, _, f):
    """Black level = read noise / s, without an offset pattern; codes below 0 are cut."""
    c.black, c.offset = c.read * c.gain / c.s, np.zeros((c.n, c.n))


@kind("periodic-interference", "periodic-interference", (0.12, 1.2), "DN", "black")
def interference(c, v, f):
    """v + s sin(2 pi (k p + phase)), p the pixel's number in read-out order, k = 0.02-0.48, phase new each frame."""
    line = c.once("line", lambda r: r.uniform(0.02, 0.48))
    return v + c.s * np.sin(2 * np.pi * (line * np.arange(c.n**2).reshape(c.n, c.n) + c.r.random()))


@kind("temporal-filter", "temporal-filter", (0.012, 0.12), "1", "black")
def temporal(c, v, f):
    """out = (1 - s) v + s (out of the frame before), before rounding."""
    out = (1 - c.s) * v + c.s * c.memory.get("out", v)
    c.memory["out"] = out
    return out


@kind("sharpening, 3x3 box", "spatial-filter", (0.006, 0.06), "1", "black")
def sharpen(c, v, f):
    """v + s (v - mean of its 3x3 box), before rounding."""
    return v + c.s * (v - box9(v))


@kind("smoothing, 4 neighbours", "spatial-filter", (0.001, 0.01), "1", "black")
def smooth(c, v, f):
    """(1 - 4 s) v + s (sum of the four neighbours), before rounding."""
    return (1 - 4 * c.s) * v + c.s * near4(v)


# ---- Catalogue: converter and firmware -----------------------------------------------------------------------------------------


def convert_by_weights(c, v, weights):
    """Code k is sent where v is above sum(bits of k * weights) - 1/2; where weights cross, codes are lost."""
    def edges(_):
        level = ((np.arange(FULL + 1)[:, None] >> np.arange(12) & 1) * weights).sum(1)
        return np.maximum.accumulate(level[1:] - 0.5)

    return np.searchsorted(c.once("edges", edges), v).astype(float)


@kind("bit weights", "adc-nonlinearity", (0.03, 0.19), "DN", "adc")
def low_bits(c, v, f):
    """Weights of bits 1 to 5 off by U(-s, s)."""
    off = c.once("bits", lambda r: np.concatenate([[0], r.uniform(-c.s, c.s, 5), np.zeros(6)]))
    return convert_by_weights(c, v, 2.0 ** np.arange(12) + off)


@kind("top bits unequal", "adc-nonlinearity", (0.15, 1.5), "DN", "adc")
def top_bits(c, v, f):
    """Weights of the five highest bits off by U(-s, s)."""
    off = c.once("bits", lambda r: np.concatenate([np.zeros(7), r.uniform(-c.s, c.s, 5)]))
    return convert_by_weights(c, v, 2.0 ** np.arange(12) + off)


@kind("random code widths", "adc-nonlinearity", (0.04, 0.4), "DN", "adc")
def code_widths(c, v, f):
    """Edge k at k - 1/2 + s N(k), sorted: every code has a width of its own."""
    edges = c.once("edges", lambda r: np.sort(np.arange(1, FULL + 1) - 0.5 + c.s * r.standard_normal(FULL)))
    return np.searchsorted(edges, v).astype(float)


@kind("coarse-quantization", "coarse-quantization", (2, 12), "DN", "adc")
def coarse(c, v, f):
    """S round(v / S), S = s as a whole number."""
    return round(c.s) * np.round(v / round(c.s))


@kind("companding, square root", "companding", (4, 40), "DN at full scale", "digital")
def square_root(c, code, f):
    """Sent as u = round(M sqrt(code / 4095)), given out as 4095 (u / M)^2 rounded; M = 8190 / s."""
    m = round(2 * FULL / c.s)
    return FULL * (np.round(m * np.sqrt(code / FULL)) / m) ** 2


@kind("companding, pieces", "companding", (2, 20), "DN at full scale", "digital")
def pieces(c, code, f):
    """Steps of 1, 2, 4 .. 2^k (s as a power of two); the step doubles at 4096 / 2^k, .., 1024, 2048; middles are given out."""
    out, top = code.copy(), int(np.round(np.log2(c.s)))
    for k in range(1, top + 1):
        step, low = 2**k, 4096 // 2 ** (top + 1 - k)
        out = np.where(code >= low, code // step * step + step // 2, out)
    return out


@kind("temporal filter, rounded", "temporal-filter", (0.02, 0.2), "1", "digital")
def temporal_rounded(c, code, f):
    """Sent = floor((1 - s) code + s (sent before) + 1/2)."""
    c.memory["sent"] = np.floor((1 - c.s) * code + c.s * c.memory.get("sent", code) + 0.5)
    return c.memory["sent"]


@kind("sharpening, rounded", "spatial-filter", (0.005, 0.05), "1", "digital")
def sharpen_rounded(c, code, f):
    """floor((1 + 4 s) code - s (sum of the four neighbours) + 1/2)."""
    return (1 + 4 * c.s) * code - c.s * near4(code)


# ---- Clean: nothing must be named ----------------------------------------------------------------------------------------------


@kind("clean", CLEAN, (1, 1), "1", "none")
def clean(c, x, f):
    """Nothing."""


@kind("cosmic rays", CLEAN, (0.2, 2), "hits/frame", "stored")
def cosmic(c, q, f):
    """Poisson(s) single pixels of a frame + U(300, 3000) e."""
    for _ in range(c.r.poisson(c.s)):
        q[tuple(c.r.integers(0, c.n, 2))] += c.r.uniform(300, 3000)
    return q


@kind("less noise than a code", CLEAN, (0.12, 0.4), "DN", "constants")
def little_noise(c, x, f):
    """Read noise of s DN, gain of 0.02-0.05 DN/e."""
    c.gain = c.r.uniform(0.02, 0.05)
    c.read = c.s / c.gain
    c.peak = 0.9 * (FULL - c.black) / c.gain


@kind("one flash", CLEAN, (0.05, 0.5), "1", "light")
def flash(c, x, f):
    """One frame of one flat set below 0.65 of the peak, not its first: light times 1 + s."""
    sets = [i for i, (k, _, t, light) in enumerate(PLAN) if k == "flat" and t * light < 0.65 * PEAK_S]
    hit = c.once("hit", lambda r: (r.choice(sets), r.integers(1, 8)))
    return x * (1 + c.s * ((f.set, f.index) == hit))


# ---- Outside: the light --------------------------------------------------------------------------------------------------------


LAMP = "illumination-drift illumination-flicker illumination-setting"


@kind("lamp that oscillates", OUTSIDE, (0.0005, 0.005), "1", "light", LAMP)
def lamp_sine(c, x, f):
    """Light times 1 + s sin(2 pi (t / P + phase)), P = 0.7-4 s."""
    period, phase = c.once("wave", lambda r: (r.uniform(0.7, 4), r.random()))
    return x * (1 + c.s * np.sin(2 * np.pi * (f.t / period + phase)))


@kind("lamp that jumps once", OUTSIDE, (0.001, 0.01), "1", "light", "illumination-drift illumination-setting")
def lamp_jump(c, x, f):
    """Light times 1 + s from one moment on, at 12-16 s."""
    return x * (1 + c.s * (f.t > c.once("moment", lambda r: r.uniform(12, 16))))


@kind("light leak that blinks", OUTSIDE, (2, 20), "e", "charge", "stray-light offset-drift illumination-flicker dark-current-drift")
def leak(c, x, f):
    """Every third frame + s e in each pixel (a status lamp inside the housing), darks too, at any exposure."""
    return x + c.s * (f.number % 3 == 0)


@kind("vibration", OUTSIDE, (0.05, 0.5), "px", "light")
def vibration(c, x, f):
    """Light (scene times a card of 3 % grain, 2 px wide) is moved by s N px along both axes in each frame; the pixels are not."""
    def grain(r):
        fy, fx = np.meshgrid(np.fft.fftfreq(c.n), np.fft.rfftfreq(c.n), indexing="ij")
        g = np.fft.irfft2(np.fft.rfft2(r.standard_normal((c.n, c.n))) * np.exp(-2 * (np.pi * 2) ** 2 * (fy**2 + fx**2)))
        return 1 + 0.03 * g / g.std()

    image = c.once("card", grain) * (c.scene if f.kind == "scene" else 1)
    now = image
    for axis, d in enumerate(np.clip(c.s * c.normal(2), -1, 1)):
        now = (1 - abs(d)) * now + abs(d) * np.roll(now, 1 if d > 0 else -1, axis)
    return x * now / (c.scene if f.kind == "scene" else 1)


@kind("fields under a flickering lamp", OUTSIDE, (0.0005, 0.005), "1", "light", "illumination-flicker light-banding")
def fields(c, x, f):
    """Even and odd rows are exposed one after the other: light of each parity times 1 + s N of its own in each frame."""
    return x * (1 + c.s * c.normal(2)[np.arange(c.n) % 2][:, None])


@kind("lens ghost", OUTSIDE, (0.006, 0.06), "1", "light", "stray-light")
def lens_ghost(c, x, f):
    """Light + s (light turned by 180 degrees and moved by a tenth of the image); the pixel's response is applied after it."""
    light = x / c.k
    return x + c.k * c.s * np.roll(light[::-1, ::-1], c.n // 10, (0, 1))


@kind("shutter that opens with jitter", OUTSIDE, (3e-6, 3e-5), "s", "charge", "light-banding exposure-offset illumination-flicker")
def jitter(c, x, f):
    """Row y is exposed for T + s (y / rows) N, one N for each frame."""
    return x + f.rate * c.s * (np.arange(c.n) / c.n)[:, None] * c.r.standard_normal()


# ---- Outside: the charge -------------------------------------------------------------------------------------------------------


@kind("glow that fades", OUTSIDE, (3, 30), "e", "charge", "dark-current-drift offset-drift")
def glow(c, x, f):
    """Charge + s exp(-t / 5 s) exp(-distance / (rows / 3)) from the amplifier's corner, at any exposure."""
    distance = np.hypot(*np.mgrid[0 : c.n, 0 : c.n])
    return x + c.s * np.exp(-max(f.t, 0) / 5 - 3 * distance / c.n)


@kind("lag that saturates", OUTSIDE, (0.01, 0.1), "1", "stored", "image-lag")
def lag_full(c, q, f):
    """h = s q0 (1 - exp(-q / q0)) stays behind and comes with the next frame; q0 = 0.02-0.1 q_peak."""
    q0 = c.once("q0", lambda r: r.uniform(0.02, 0.1)) * c.peak
    h = c.s * q0 * (1 - np.exp(-q / q0))
    before, c.memory["h"] = c.memory.get("h", 0.0), h
    return q - h + before


@kind("coupling along the rows", "interpixel-crosstalk", (0.002, 0.02), "1", "stored")
def coupling_rows(c, q, f):
    """(1 - 2 s) q + s (left + right), after the shot noise."""
    return (1 - 2 * c.s) * q + c.s * (np.roll(q, 1, 1) + np.roll(q, -1, 1))


@kind("coupling down the columns", "interpixel-crosstalk", (0.002, 0.02), "1", "stored")
def coupling_columns(c, q, f):
    """(1 - 2 s) q + s (up + down), after the shot noise."""
    return (1 - 2 * c.s) * q + c.s * (np.roll(q, 1, 0) + np.roll(q, -1, 0))


@kind("lag of some electrons", OUTSIDE, (2, 20), "e", "stored", "image-lag offset-drift")
def lag_electrons(c, q, f):
    """Every pixel keeps s (1 - exp(-q / 50 s)) for the next frame."""
    held = c.memory.get("held", 0)
    c.memory["held"] = c.s * (1 - np.exp(-q / (50 * c.s)))
    return q + held - c.memory["held"]


@kind("diagonal coupling", OUTSIDE, (0.003, 0.03), "1", "stored", "interpixel-crosstalk")
def diagonal(c, q, f):
    """(1 - s) q + s (neighbour up and left)."""
    return (1 - c.s) * q + c.s * np.roll(q, (1, 1), (0, 1))


@kind("coupling that grows", "brighter-fatter", (0.001, 0.01), "1", "stored")
def coupling(c, q, f):
    """q + s / q_peak times the sum over the four neighbours n of (n^2 - q^2) / 2: (n - q) moves the boundary that charge (n + q) / 2 crosses."""
    return q + c.s / c.peak * (near4(q**2) - 4 * q**2) / 2


@kind("excess noise, power 1.5", OUTSIDE, (0.1, 0.8), "1", "stored")
def excess(c, q, f):
    """q + s sqrt(q_peak) (q / q_peak)^0.75 N: its variance grows as mean^1.5; s is its share of the shot noise at the peak."""
    return q + c.s * np.sqrt(c.peak) * (np.maximum(q, 0) / c.peak) ** 0.75 * c.normal(c.n, c.n)


# ---- Outside: read noise -------------------------------------------------------------------------------------------------------


@kind("noise shared by 2x2", OUTSIDE, (0.4, 4), "e", "read", "spatial-filter row-noise column-noise")
def shared(c, q, f):
    """q + s N(block of 2x2 pixels)."""
    return q + c.s * np.kron(c.normal(c.n // 2, c.n // 2), np.ones((2, 2)))


@kind("1/f noise down the rows", "row-noise", (0.2, 2), "e", "read")
def pink_rows(c, q, f):
    """q + s w(y); w is a slow random series (AR(1) or 1/f) drawn anew each frame."""
    return q + c.s * wander(c)


@kind("heavy tails", OUTSIDE, (0.1, 1), "1", "noise", "random-telegraph-noise")
def heavy(c, noise, f):
    """Read noise + s read T3 / sqrt(3), T3 of Student's distribution with 3 degrees of freedom."""
    return noise + c.s * c.read * c.r.standard_t(3, noise.shape) / np.sqrt(3)


@kind("noise two pixels apart", OUTSIDE, (0.05, 0.5), "1", "noise", "readout-lowpass spatial-filter periodic-interference")
def two_apart(c, noise, f):
    """(n(x) + s n(x - 2)) / sqrt(1 + s^2): only pixels two apart along the row are correlated."""
    return (noise + c.s * np.roll(noise, 2, 1)) / np.sqrt(1 + c.s**2)


def part(c, shape):
    """One of: right half, lower half, odd columns, odd rows, blocks of 16 x 16 as on a chessboard."""
    y, x = np.indices(shape)
    parts = (x >= shape[1] // 2, y >= shape[0] // 2, x % 2 == 1, y % 2 == 1, (x // 16 + y // 16) % 2 == 1)
    return parts[c.once("part", lambda r: r.integers(len(parts)))]


@kind("read noise of parts", OUTSIDE, (0.05, 0.5), "1", "noise")
def noise_of_parts(c, q, f):
    """The read noise of one part of the image times 1 + s, see `part`."""
    return q * (1 + c.s * part(c, q.shape))


@kind("noise of odd frames", OUTSIDE, (0.05, 0.5), "1", "noise")
def odd_frames(c, noise, f):
    """Read noise of every second frame times 1 + s."""
    return noise * (1 + c.s * (f.number % 2))


@kind("noise that grows with time", OUTSIDE, (0.1, 1), "1", "noise", "random-telegraph-noise gain-drift")
def ageing(c, noise, f):
    """Read noise times 1 + s t / 16 s."""
    return noise * (1 + c.s * max(f.t, 0) / 16)


@kind("interference in bursts", OUTSIDE, (0.6, 6), "e", "read", "row-noise periodic-interference")
def bursts(c, q, f):
    """A band of 6 rows, at a place of its own in each frame: q + s N(row)."""
    first = c.r.integers(0, c.n - 6)
    q[first : first + 6] += c.s * c.normal(6, 1)
    return q


# ---- Outside: amplifier --------------------------------------------------------------------------------------------------------


@kind("row gain noise", OUTSIDE, (0.0002, 0.002), "1", "amplifier", "light-banding row-noise")
def row_gain(c, v, f):
    """v (1 + s N(row)), rows independent."""
    return v * (1 + c.s * c.normal(c.n, 1))


@kind("row gain noise in blocks", OUTSIDE, (0.0002, 0.002), "1", "amplifier", "light-banding row-noise")
def block_gain(c, v, f):
    """v (1 + s N(block of 8 rows))."""
    return v * (1 + c.s * np.repeat(c.normal(c.n // 8, 1), 8, 0))


@kind("gain noise of halves", OUTSIDE, (0.0003, 0.003), "1", "amplifier", "illumination-flicker column-gain-noise tap-mismatch")
def half_gain(c, v, f):
    """v (1 + s N(half)): the left and the right converter have a reference of their own in each frame."""
    return v * (1 + c.s * np.repeat(c.normal(1, 2), c.n // 2, 1))


@kind("gain of every second frame", OUTSIDE, (0.0005, 0.005), "1", "amplifier", "illumination-flicker gain-drift tap-mismatch")
def ping_pong(c, v, f):
    """v (1 + s) in every second frame: two stores are used in turn."""
    return v * (1 + c.s * (f.number % 2))


@kind("dual-gain switch", OUTSIDE, (0.002, 0.02), "1", "amplifier", "nonlinearity adc-nonlinearity")
def dual_gain(c, v, f):
    """v (1 + s) above a level of 0.2-0.6 of 4095, v below: the two gains do not match."""
    return v * (1 + c.s * (v > FULL * c.once("level", lambda r: r.uniform(0.2, 0.6))))


@kind("echo along the row", OUTSIDE, (0.006, 0.06), "1", "amplifier", "readout-lowpass spatial-filter")
def echo(c, v, f):
    """v(x) + s v(x - d), d = 3-12 px: a reflection in the cable."""
    return v + c.s * np.roll(v, c.once("d", lambda r: r.integers(3, 13)), 1)


@kind("amplifier memory of the last row", OUTSIDE, (0.003, 0.03), "1", "amplifier", "readout-lowpass charge-transfer-inefficiency")
def row_memory(c, v, f):
    """(1 - s) v(y) + s v(y - 1): the column amplifier is not fully reset; noise is carried too, in darks as in flats."""
    return (1 - c.s) * v + c.s * np.vstack([v[:1], v[:-1]])


@kind("bend of each column", OUTSIDE, (0.003, 0.03), "1", "amplifier", "nonlinearity tap-mismatch")
def column_bend(c, v, f):
    """v (1 - s N(column) v / 4095), N a constant of the column: the mean of all columns stays straight."""
    return v * (1 - c.s * c.once("bend", lambda r: r.standard_normal((1, c.n))) * v / FULL)


@kind("toe near black", "nonlinearity", (0.4, 4), "DN", "amplifier")
def toe(c, v, f):
    """v - s (1 - exp(-v / t)) above 0, t = 10-60 DN."""
    t = c.once("toe", lambda r: r.uniform(10, 60))
    return v - c.s * (1 - np.exp(-np.maximum(v, 0) / t))


@kind("sensor that warms up", "dark-current-drift", (0.02, 0.2), "1", "charge")
def warms_up(c, x, f):
    """Dark charge times 1 + s (1 - exp(-t / 10 s))."""
    return x + c.dark * f.exposure * c.s * (1 - np.exp(-max(f.t, 0) / 10))


@kind("threshold on small signals", OUTSIDE, (0.2, 3), "DN", "amplifier", "nonlinearity black-clipping")
def soft_threshold(c, v, f):
    """sign(v) max(|v| - s, 0): coring around black."""
    return np.sign(v) * np.maximum(np.abs(v) - c.s, 0)


@kind("black clamp with a lag", OUTSIDE, (0.0004, 0.004), "1", "amplifier", "image-lag offset-drift")
def clamp(c, v, f):
    """v - s b; b follows the mean of the frames before: b += a (mean - b), a = 0.2-0.6."""
    a, b = c.once("a", lambda r: r.uniform(0.2, 0.6)), c.memory.get("b", 0.0)
    c.memory["b"] = b + a * (v.mean() - b)
    return v - c.s * b


@kind("droop down the rows", OUTSIDE, (0.004, 0.04), "1", "amplifier", "nonlinearity tap-mismatch")
def droop(c, v, f):
    """v(y) (1 - s (mean of the frame) / 4095 y / rows): the supply of the amplifiers falls while a bright frame is read."""
    return v * (1 - c.s * v.mean() / FULL * (np.arange(c.n) / c.n)[:, None])


@kind("black level set anew", OUTSIDE, (0.05, 0.5), "DN", "black", "offset-drift")
def black_setting(c, v, f):
    """v + s N, one N for all frames of a set."""
    return v + c.s * c.once(("set", f.set), lambda r: r.standard_normal())


@kind("black level that wanders", OUTSIDE, (0.05, 0.5), "DN", "black", "offset-drift")
def black_wanders(c, v, f):
    """v + s w, w a first-order autoregression over the frames with 0.98 from one to the next."""
    w = c.memory["w"] = 0.98 * c.memory.get("w", 0.0) + np.sqrt(1 - 0.98**2) * c.r.standard_normal()
    return v + c.s * w


@kind("black level that beats", OUTSIDE, (0.06, 0.6), "DN", "black", "offset-drift")
def black_sine(c, v, f):
    """v + s sin(2 pi (t / P + phase)), P = 0.7-4 s: the cooler's control loop."""
    period, phase = c.once("wave", lambda r: (r.uniform(0.7, 4), r.random()))
    return v + c.s * np.sin(2 * np.pi * (f.t / period + phase))


# ---- Outside: firmware ---------------------------------------------------------------------------------------------------------


@kind("denoiser with a threshold", OUTSIDE, (0.05, 0.5), "1", "digital", "spatial-filter")
def denoiser(c, code, f):
    """d = code - mean of its 3x3 box; code - s d where |d| is below 1.5 sigma of read and shot noise, else code."""
    box = box9(code)
    d = code - box
    limit = 1.5 * np.sqrt((c.gain * c.read) ** 2 + c.gain * np.maximum(box - c.black, 0))
    return code - c.s * d * (np.abs(d) < limit)


# The contract's spatial-filter is any in-camera smoothing after the noise, and this is one; what acts only below or above a threshold has
# no name there.
@kind("median filter", "spatial-filter", (0.02, 0.2), "1", "digital")
def median(c, code, f):
    """(1 - s) code + s (median of its 3x3 box)."""
    return (1 - c.s) * code + c.s * box9(code, np.median)


@kind("DCT of 8x8 blocks", OUTSIDE, (1, 10), "DN", "digital", "spatial-filter coarse-quantization companding")
def dct(c, code, f):
    """Coefficient (i, j) of the orthonormal 8x8 DCT is rounded to multiples of s (1 + (i + j) / 4)."""
    i = np.arange(8)
    d = np.sqrt(np.where(i == 0, 1, 2) / 8)[:, None] * np.cos(np.pi * i[:, None] * (2 * i + 1) / 16)
    blocks = code.reshape(c.n // 8, 8, c.n // 8, 8).transpose(0, 2, 1, 3)
    step = c.s * (1 + (i[:, None] + i) / 4)
    blocks = d.T @ (step * np.round(d @ blocks @ d.T / step)) @ d
    return blocks.transpose(0, 2, 1, 3).reshape(c.n, c.n)


@kind("hot-pixel correction", OUTSIDE, (0.25, 1), "1/sigma", "digital", "spatial-filter")
def defects(c, code, f):
    """A code above its 3x3 median by more than sigma / s (sigma of read and shot noise) becomes that median."""
    middle = box9(code, np.median)
    sigma = np.sqrt((c.gain * c.read) ** 2 + c.gain * np.maximum(middle - c.black, 0))
    return np.where(code - middle > sigma / c.s, middle, code)


@kind("digital gain", OUTSIDE, (0.002, 0.02), "1", "digital", "coarse-quantization adc-nonlinearity companding")
def digital_gain(c, code, f):
    """floor((1 + s) code): one code in 1 / s never occurs."""
    return np.floor((1 + c.s) * code)


@kind("defects filled in", CLEAN, (0.003, 0.03), "1", "digital")
def filled_in(c, code, f):
    """A share s of the pixels, the same in every frame, is the mean of left and right neighbours."""
    dead = c.once("dead", lambda r: r.random(code.shape) < c.s)
    return np.where(dead, 0.5 * (np.roll(code, 1, 1) + np.roll(code, -1, 1)), code)


@kind("converter with a sawtooth", OUTSIDE, (0.2, 2), "DN", "adc", "adc-nonlinearity")
def sawtooth(c, v, f):
    """Codes of v + s (frac(v / p) - 1/2), p = 50-400 DN."""
    p = c.once("period", lambda r: r.uniform(50, 400))
    return np.round(v + c.s * (np.mod(v / p, 1) - 0.5))


@kind("sparkle codes", OUTSIDE, (3e-6, 1e-4), "1", "digital", "adc-nonlinearity random-telegraph-noise")
def sparkle(c, code, f):
    """With probability s one of bits 6 to 10 of a code is turned over."""
    hit = c.r.random(code.shape) < c.s
    return np.where(hit, code.astype(int) ^ (1 << c.r.integers(6, 11, code.shape)), code).astype(float)


@kind("motion-adaptive filter", OUTSIDE, (0.03, 0.3), "1", "digital", "temporal-filter")
def adaptive(c, code, f):
    """d = code - sent before; sent = code - s d where |d| is below 1.5 sigma of read and shot noise, else code."""
    d = code - c.memory.get("sent", code)
    limit = 1.5 * np.sqrt((c.gain * c.read) ** 2 + c.gain * np.maximum(code - c.black, 0))
    c.memory["sent"] = np.floor(code - c.s * d * (np.abs(d) < limit) + 0.5)
    return c.memory["sent"]


# ---- Datasets, diagnosis, judgement --------------------------------------------------------------------------------------------

BY_KEY = {k.key: k for k in KINDS.values()}


def draw(folder, camera, seed):
    """Write the camera's campaign as a dataset. Up to two bright frames are exposed before the first recorded one."""
    (folder / "frames").mkdir(parents=True, exist_ok=True)
    frames = [Frame("flat", PEAK_S, 1, 0, -1, i, i - camera.past) for i in range(camera.past)]
    for number, (what, count, exposure, light) in enumerate(PLAN):
        frames += [Frame(what, exposure, light, 0, number, i, len(frames) - camera.past + i) for i in range(count)]
    t, rows = -camera.past * (PEAK_S + GAP_S), []
    for f in frames:
        f.t, camera.step = t, f.exposure + GAP_S
        image, file = camera.frame(f), f"frames/{len(rows):05}.tiff"
        t += camera.step
        if f.set >= 0:
            tifffile.imwrite(folder / file, image)
            rows.append(f"{file},{f.kind},{f.set},{f.index},{f.exposure:g},{f.light:g},0,,{f.t:.6f}")
    header = "file,kind,set,index,exposure_s,illumination,configuration,temperature_c,timestamp_s"
    (folder / "frames.csv").write_text("\n".join([header, *rows]) + "\n")
    truth = {"kind": camera.kind.name, "truth": camera.kind.truth, "near": camera.kind.near, "strength": camera.s}
    truth |= {"gain_dn_per_e": camera.gain, "read_noise_e": camera.read, "black_dn": camera.black, "frames_before": camera.past}
    (folder / "truth.json").write_text(json.dumps(truth, indent=1) + "\n")
    (folder / "dataset.toml").write_text(  # last: a folder that has it is complete
        f'format = "radcam-dataset/1"\n\n[camera]\nvendor = "outside"\nmodel = "simulated"\nserial = "{seed}"\n'
        f'width = {camera.n}\nheight = {camera.n}\nbit_depth = 12\npixel_format = "Mono12"\n'
    )


def judge(what, answer):
    """One of right, unknown, consistent, wrong, for what stands first; `close` and `bare` tell more of a wrong name.

    Catalogue: right if the truth stands first, or in a tie at the head of the list. Clean: right if nothing is named. Outside:
    right if `unknown` stands first, counted as unknown. Where nothing is named the verdict is consistent: a weak effect, not seen.
    """
    missing = answer["missing"]
    names = [m["effect"] for m in missing]
    said = {"names": names, "close": False, "nearest": missing[0].get("nearest", []) if missing else []}
    if not names:
        return said | {"verdict": "right" if what.truth == CLEAN else "consistent"}
    if names[0] == "unknown":
        return said | {"verdict": "unknown"}
    tied = ["a tie" in str(m["evidence"]) for m in missing]
    ahead = 1
    while ahead < len(names) and (tied[ahead] or (ahead == 1 and tied[0])):
        ahead += 1
    return said | {"verdict": "right" if what.truth in names[:ahead] else "wrong", "close": names[0] in what.near}


def run(said, what, seed, place=None):
    """Draw, diagnose, judge, print one line. Returns the row, with `verdict` error where the program failed."""
    camera = Camera(what, seed, said.size, place)
    camera.past = camera.past if said.past is None else said.past
    folder = said.out / f"{what.key.replace(' ', '-').replace('/', '')}-{seed}-{camera.s:.3g}-{said.size}-{camera.past}"
    began = time.perf_counter()
    kept = (folder / "dataset.toml").exists()
    if not kept:
        draw(folder, camera, seed)
    drawn = time.perf_counter()
    row = {"kind": what.name, "seed": seed, "strength": camera.s, "past": camera.past, "draw_s": drawn - began}
    command = [said.radcam, "diagnose", folder, "--json"]
    try:
        out = subprocess.run(command, check=False, capture_output=True, text=True, timeout=said.timeout)
        answer = json.loads(out.stdout) if out.returncode in (0, 1) else None
        fault = out.stderr.strip()[-200:]
    except subprocess.TimeoutExpired:
        answer, fault = None, f"no answer in {said.timeout:g} s"
    row["diagnose_s"] = time.perf_counter() - drawn
    head = f"{what.name:36} {seed:4} {camera.s:9.3g} "
    if answer is None:
        row |= {"verdict": "error", "fault": fault}
        print(f"{head} ERROR {fault}  [{row['diagnose_s']:.1f} s]", flush=True)
    else:
        row |= judge(what, answer) | {"before": answer["error_before"], "after": answer["error_after"]}
        row["left"] = (answer.get("remainder") or {}).get("share", 0)
        row["p"] = [r["p_value"] for r in (answer["ladder"][0], answer["ladder"][-1])]
        row |= {"consistent": answer["consistent"], "sure": answer["missing"][0]["confidence"] if answer["missing"] else None}
        entries = [f"{m['effect']} {m['confidence']:.2f}{' (partial)' if m.get('partial') else ''}" for m in answer["missing"]]
        near = f"; nearest: {' '.join(row['nearest'])}" if row["nearest"] else ""
        silent = "consistent" if answer["consistent"] else "INCONSISTENT, nothing named"
        verdict = row["verdict"].upper() if row["verdict"] == "wrong" else row["verdict"]
        print(
            f"{head} {row['before']:8.2f} -> {row['after']:6.3f}  {verdict:10} {', '.join(entries) or silent}{near}; left {row['left']:.2g}  "
            f"[{row['diagnose_s']:.1f} s]",
            flush=True,
        )
    if said.rows:
        with said.rows.open("a") as file:
            file.write(json.dumps(row) + "\n")
    if not said.keep and not kept:
        shutil.rmtree(folder)
    return row


def matrix(rows):
    """The table and sums of a campaign, in Markdown. A camera counts once: right, unknown, consistent, wrong or failed."""
    print("\n| kind | in catalogue | n | right first (or a tie holding the truth) | unknown first | consistent "
          "| wrong first without unknown before it | of these near | of these error after < 1.15 | failed | largest error after |")
    print("|---|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|")
    for what in KINDS.values():
        mine = [r for r in rows if r["kind"] == what.name]
        if mine:
            n = {v: [r for r in mine if r["verdict"] == v] for v in ("right", "unknown", "consistent", "wrong", "error")}
            listed = {CLEAN: "clean", OUTSIDE: "no"}.get(what.truth, what.truth)
            near, low = sum(r["close"] for r in n["wrong"]), sum(r["after"] < 1.15 for r in n["wrong"])
            worst = max((r["after"] for r in mine if r["verdict"] != "error"), default=float("nan"))
            right = "-" if what.truth == OUTSIDE else len(n["right"])
            weak = "-" if what.truth == CLEAN else len(n["consistent"])
            cells = [what.name, listed, len(mine), right, len(n["unknown"]), weak, len(n["wrong"]), near, low, len(n["error"])]
            print(f"| {' | '.join(map(str, cells))} | {worst:.3f} |")
    print()

    def share(text, part, whole):
        print(f"- {text}: {len(part)} of {len(whole)}{f' ({100 * len(part) / len(whole):.1f} %)' if whole else ''}")

    done = [r for r in rows if r["verdict"] != "error"]
    wrong = [r for r in done if r["verdict"] == "wrong"]
    share("wrong name first without unknown before it, all kinds", wrong, done)
    for text in ("catalogue", CLEAN, OUTSIDE):
        mine = [r for r in done if KINDS[r["kind"]].group == text]
        share(f"wrong name first, {text} kinds", [r for r in mine if r["verdict"] == "wrong"], mine)
        share(f"right, {text} kinds", [r for r in mine if r["verdict"] == ("unknown" if text == OUTSIDE else "right")], mine)
        seen = [r for r in mine if r["names"]]
        share(f"wrong name first, {text} kinds where anything was named", [r for r in seen if r["verdict"] == "wrong"], seen)
    foreign = [r for r in wrong if KINDS[r["kind"]].truth == OUTSIDE]
    share("outside kinds with a wrong name first: the name is physically near", [r for r in foreign if r["close"]], foreign)
    share("outside kinds with a wrong name first: error after < 1.15", [r for r in foreign if r["after"] < 1.15], foreign)
    share("wrong name first: confidence at least 0.9", [r for r in wrong if (r["sure"] or 0) >= 0.9], wrong)
    able = [r for r in done if r["verdict"] == "unknown" and KINDS[r["kind"]].near]
    met = [r for r in able if {*r["nearest"]} & {*KINDS[r["kind"]].near}]
    share("unknown first, near list not empty: `nearest` holds one of it", met, able)
    share("nothing named, though inconsistent", [r for r in done if not r["names"] and not r["consistent"]], done)
    share("failed", [r for r in rows if r["verdict"] == "error"], rows)
    times = sorted(r["diagnose_s"] for r in done) or [0]
    print(f"- diagnose: median {times[len(times) // 2]:.1f} s, longest {times[-1]:.1f} s")


# Kind and seed of `--quick`, at plain strength (the upper end of the range), and some that are weak and near an effect.
QUICK = (
    ("clean", 1), ("black level too low", 1), ("row-noise", 1), ("nonlinearity, square", 1), ("offset-drift", 1),
    ("noise of odd frames", 1), ("noise shared by 2x2", 1), ("gain of every second frame", 1), ("cosmic rays", 1),
    ("temporal-filter", 2), ("read noise of parts", 1), ("defects filled in", 1),
    ("coupling along the rows", 1), ("toe near black", 1), ("less noise than a code", 1),
    ("telegraph noise, fast", 3),
)
QUICK_WEAK = (("heavy tails", 151, 0.35), ("row gain noise in blocks", 142, 0.45), ("interference in bursts", 161, 0.5),
              ("digital gain", 142, 0.5), ("hot-pixel correction", 171, 0.6315),
              ("threshold on small signals", 301, 0.3))


def main():
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--radcam", default="target/release/radcam")
    ask.add_argument("--out", type=pathlib.Path, default=pathlib.Path("cameras"))
    ask.add_argument("--seeds", default="1")
    ask.add_argument("--only", default=",".join(BY_KEY), help="names without commas; or catalogue, clean, outside")
    ask.add_argument("--strength", type=float, help="place in the range of strengths, 0 barely visible to 1 plain; else drawn")
    ask.add_argument("--past", type=int, help="bright frames before the first recorded one; else drawn, 0 to 2")
    ask.add_argument("--size", type=int, default=96, help="rows and columns, a multiple of 16")
    ask.add_argument("--timeout", type=float, default=600, help="seconds for one diagnosis")
    ask.add_argument("--keep", action="store_true", help="leave the datasets")
    ask.add_argument("--campaign", type=int, metavar="N", help="N cameras, cycling over the kinds, and a table")
    ask.add_argument("--first-seed", type=int, default=1)
    ask.add_argument("--rows", type=pathlib.Path, help="add each row to this file, as a line of JSON")
    ask.add_argument("--quick", action="store_true")
    ask.add_argument("--list", action="store_true")
    ask.add_argument("--table", type=pathlib.Path, metavar="FILE", help="only the table of rows that --rows has written")
    said = ask.parse_args()
    if said.list:
        print("| kind | truth | strength | unit | stage | near | equation |\n|---|---|---|---|---|---|---|")
        for k in KINDS.values():
            says = k.act.__doc__.replace("|", "\\|")
            print(f"| {k.name} | {k.truth} | {k.span[0]:g} - {k.span[1]:g} | {k.unit} | {k.stage} | {', '.join(k.near)} | {says} |")
        return None
    if said.table:
        return matrix([json.loads(line) for line in said.table.read_text().splitlines()])
    wanted = []
    for part in said.only.split(","):
        found = [BY_KEY[part]] if part in BY_KEY else [k for k in KINDS.values() if part == k.group]
        if not found:
            sys.exit(f"no kind {part!r}; --list shows them")
        wanted += found
    if said.quick:
        todo = [(KINDS[name], seed, place) for name, seed, place in [(*q, 1.0) for q in QUICK] + list(QUICK_WEAK)]
    elif said.campaign:
        todo = [(wanted[i % len(wanted)], said.first_seed + i // len(wanted), said.strength) for i in range(said.campaign)]
    else:
        todo = [(k, int(seed), said.strength) for seed in said.seeds.split(",") for k in wanted]
    rows = [run(said, *one) for one in todo]
    if said.campaign:
        matrix(rows)
    count = {v: sum(r["verdict"] == v for r in rows) for v in ("right", "unknown", "consistent", "wrong", "error")}
    print("\n" + ", ".join(f"{n} {v}" for v, n in count.items()))
    missed = [r for r in rows if KINDS[r["kind"]].truth != OUTSIDE and r["verdict"] != "right"] if said.quick else []
    # A name that comes nearest to a shape of no catalogue is no wrong one.
    wrong = [r for r in rows if r["verdict"] == "wrong" and not r["close"]]
    sys.exit(2 if count["error"] else 1 if wrong or missed else 0)


if __name__ == "__main__":
    main()
