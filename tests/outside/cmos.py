#!/usr/bin/env python3
"""Campaigns of a CMOS camera "as it is sold", with known truth: an independent test generator.

Written blind to the program under test: it shares no code with it and follows only the data
format of the contract (dataset.toml, frames.csv, frames/*.tif) and the definitions of effects.

    cmos.py draw KIND SEED FOLDER [--layout L] [--strength 15]
    cmos.py list
    cmos.py strength KIND SEED                    (what each statistic sees, without writing)
    cmos.py campaign --radcam PATH --out DIR --kinds clean|effects|pairs|triples|new|all|a,b+c,d
                     --n N --first-seed S [--jobs 2] [--keep] [--layout L] [--strength 15] [--without]

KIND is "clean", the name of an effect or new shape (see `list`), several joined by "+", or
"pair" / "triple" (compatible effects chosen by the seed).

The chain, in order; every effect acts at its stage:
    light    per frame: level, flicker, drift          (frame factor)
    field    per frame and pixel: shading, dust, bands (map)
    exposure effective exposure time
    dark     dark charge of the exposure
    shot     Poisson
    charge   in the pixel, electrons (brighter-fatter is inside shot): full well, lag, crosstalk
    pixel    with the read noise, electrons: telegraph noise, row/column noise
    analog   after the amplifier, DN above black: low-pass, nonlinearity, gain drift, taps
    output   with the black level, DN: offsets, interference, gamma on the whole code
    adc      to whole codes
    digital  on codes: filters, companding, quantization, stuck bits
Strength: amplitude such that the best generic statistic moves by about that many standard errors
(campaign with and without the effect from the same random numbers).
"""
import argparse, json, math, os, shutil, struct, subprocess, sys, time, zlib
for _v in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_v, "1")
import numpy as np

F32 = np.float32
LAYOUTS = ["exposure", "light", "grid", "there-and-back", "emva-time", "emva-light", "standard", "few"]
VARIED_LIGHT = ["light", "grid", "emva-light"]               # the light is set anew from set to set
VARIED_EXPOSURE = ["exposure", "grid", "there-and-back", "emva-time", "standard"]
LONG_DARKS = ["exposure", "there-and-back", "emva-time", "standard"]


def stream(seed, name):
    """A generator of its own for each purpose, so that effects do not move each other's numbers."""
    return np.random.Generator(np.random.SFC64([int(seed), zlib.crc32(name.encode())]))


def loguniform(rng, a, b):
    return float(math.exp(rng.uniform(math.log(a), math.log(b))))


def col(x):
    """A per-frame number, shaped to multiply frames."""
    return np.asarray(x, F32)[:, None, None]


# ------------------------------------------------------------------ camera
class Camera:
    pass


def draw_camera(seed, need=()):
    r = stream(seed, "camera")
    c = Camera()
    c.seed = seed
    c.height, c.width = int(r.integers(80, 129)), int(r.integers(80, 129))
    depths = [8, 10, 12, 14, 16]
    c.bit_depth = int(depths[r.integers(5)])
    if "deep" in need and c.bit_depth < 10:
        c.bit_depth = int(r.choice([10, 12, 14]))
    if "deep12" in need and c.bit_depth < 12:
        c.bit_depth = int(r.choice([12, 14]))
    c.top = 2 ** c.bit_depth - 1
    c.full_well_e = loguniform(r, 5e3, 6e4)
    fill = r.uniform(0.9, 1.1)
    if c.bit_depth == 8 and r.random() < 0.5:
        read_dn = loguniform(r, 0.15, 0.5)
    else:
        read_dn = loguniform(r, 0.3, 4.0 if c.bit_depth > 8 else 1.5)
    gain = c.top / c.full_well_e * fill
    read_e = float(np.clip(read_dn / gain, 1.0, 60.0 if c.bit_depth > 8 else 200.0))
    read_dn = read_e * gain
    black = max(8 * math.hypot(read_dn, 0.3), c.top * r.uniform(0.008, 0.03)) * r.uniform(1.0, 1.6)
    c.black_dn = float(black + r.random())
    c.gain = float((c.top - c.black_dn) / c.full_well_e * fill)
    c.range_e = (c.top - c.black_dn) / c.gain
    h, w = c.height, c.width
    # read noise per pixel, constant in time
    c.read_sigma = r.uniform(0.1, 0.3)
    c.noisy_share = r.uniform(0, 0.01)
    read = read_e * np.exp(c.read_sigma * r.standard_normal((h, w)))
    noisy = r.random((h, w)) < c.noisy_share
    read[noisy] *= r.uniform(2, 6, noisy.sum())
    c.read_e = read.astype(F32)
    # offsets, with column structure (electrons)
    dsnu_e = read_e * r.uniform(0.1, 0.6)
    dsnu = dsnu_e * (0.8 * r.standard_normal((h, w)) + r.uniform(0.2, 0.7) * r.standard_normal((1, w)))
    c.dsnu_e = dsnu.astype(F32)
    # response
    c.prnu_rel = r.uniform(0.003, 0.015)
    c.prnu_col_rel = c.prnu_rel * r.uniform(0.1, 0.5)
    resp = 1 + c.prnu_rel * r.standard_normal((h, w)) + c.prnu_col_rel * r.standard_normal((1, w))
    dead = r.integers(0, 6)
    for _ in range(dead):
        resp[r.integers(h), r.integers(w)] = r.uniform(0.0, 0.05)
    c.dead_pixels = int(dead)
    c.resp = np.clip(resp, 0, None).astype(F32)
    # dark current, e/s
    c.dark_mean = loguniform(r, 1, 60)
    if "dark" in need:
        c.dark_mean = loguniform(r, 60, 600)
    k = r.uniform(3, 12)
    dark = r.gamma(k, c.dark_mean / k, (h, w))
    hot = r.random((h, w)) < loguniform(r, 0.0005, 0.005)
    dark[hot] += r.exponential(c.dark_mean * loguniform(r, 10, 100), hot.sum())
    c.dark = dark.astype(F32)
    # shading and dust
    yy, xx = np.mgrid[0:h, 0:w]
    cy, cx = h * r.uniform(0.3, 0.7), w * r.uniform(0.3, 0.7)
    d2 = ((yy - cy) ** 2 + (xx - cx) ** 2)
    c.rho2 = (d2 / d2.max()).astype(F32)
    c.shading = r.uniform(0, 0.4)
    if "shaded" in need:
        c.shading = r.uniform(0.15, 0.4)
    field = 1 - c.shading * c.rho2
    for _ in range(r.integers(0, 6)):
        y0, x0, s = r.uniform(0, h), r.uniform(0, w), r.uniform(1, 5)
        field = field * (1 - r.uniform(0.005, 0.08) * np.exp(-((yy - y0) ** 2 + (xx - x0) ** 2) / (2 * s * s)))
    c.field = (field / field.mean()).astype(F32)
    c.peak = float(c.field.max() * (1 + 2 * c.prnu_rel))
    c.base_exposure_s = float("%.3g" % loguniform(r, 0.004, 0.05))
    c.qe = r.uniform(0.3, 0.85)
    c.noise_dark_dn = float(math.sqrt((read_dn * 1.05) ** 2 + 1 / 12))
    c.noise_flat_dn = math.sqrt(c.noise_dark_dn ** 2 + c.gain ** 2 * c.full_well_e * 0.5)
    return c


# ------------------------------------------------------------------ plan of the campaign
class Plan:
    """Per frame: kind, set, index, exposure_s, illumination (stated), true (light factor of a set), time_s."""


def draw_plan(seed, cam, layout, memory=False):
    """memory: the camera may expose frames that are not saved: before the first set and before each set."""
    r = stream(seed, "plan")
    lead = int(r.choice([0, 0, 1, 4])) if memory else 0
    past = int(r.choice([0, 0, 2])) if memory else 0
    p = Plan()
    p.layout = layout
    p.illumination_unit, p.rel_std, scatter = "relative", None, 0.0
    n = int(r.integers(2, 17)) if layout not in ("standard", "few") else 8
    e0 = cam.base_exposure_s
    full = 0.93 / cam.peak                     # mean level at which the brightest part is at 93 % of the range
    overshoot = r.random() < 0.35
    levels = int(r.integers(8, 15))
    n = max(2, min(n, int(240 / (levels + 4))))
    spaced = np.geomspace(r.uniform(0.01, 0.05), 1, levels) if r.random() < 0.5 else np.linspace(1 / levels, 1, levels)
    extra = list(1 + np.cumsum(r.uniform(0.08, 0.3, r.integers(1, 4)))) if overshoot else []
    sig = lambda v: float("%.6g" % v)
    sets = []                                  # (kind, exposure, illumination, frames)
    long_s = sig(max(e0 * 5, r.uniform(0.2, 1.0)))
    if layout == "exposure":
        sets = [("flat", sig(e0 * v), 1.0, n) for v in list(spaced) + extra]
        for e in [sig(e0 * 0.05), e0, long_s] + ([sig(long_s / 2)] if r.random() < 0.5 else []):
            sets.append(("dark", e, 0.0, n))
        flux_e = cam.range_e * full / e0
    elif layout == "light":
        sets = [("flat", e0, sig(v), n) for v in list(spaced) + extra]
        sets += [("dark", e0, 0.0, n), ("dark", long_s, 0.0, n), ("dark", e0, 0.0, n)]
        flux_e = cam.range_e * full / e0
    elif layout == "grid":
        es, ls = np.geomspace(0.08, 1, 4), np.geomspace(r.uniform(0.05, 0.3), 1, 4)
        n = min(n, 10)
        sets = [("flat", sig(e0 * a), sig(b), n) for a in es for b in ls]
        if extra:
            sets.append(("flat", sig(e0 * extra[0]), 1.0, n))
        sets += [("dark", sig(e0 * a), 0.0, n) for a in (es[0], 1)] + [("dark", long_s, 0.0, n)]
        flux_e = cam.range_e * full / e0
    elif layout == "there-and-back":
        k = int(r.integers(6, 10))
        ups = list(np.geomspace(r.uniform(0.02, 0.06), 1, k)) + extra[:1]
        n = min(n, int(240 / (2 * k + 5)))
        d = [("dark", sig(e0 * 0.05), 0.0, n), ("dark", long_s, 0.0, n)]
        up = [("flat", sig(e0 * v), 1.0, n) for v in ups]
        sets = d + up + d[:1] + up[::-1] + d[::-1]
        flux_e = cam.range_e * full / e0
    elif layout in ("emva-time", "emva-light"):
        k = int(r.integers(12, 26))
        vals = list(np.linspace(1 / k, 1, k)) + extra
        m = int(r.integers(16, 25))
        if layout == "emva-time":
            for v in vals:
                sets += [("flat", sig(e0 * v), 1.0, 2), ("dark", sig(e0 * v), 0.0, 2)]
            h = sig(e0 * 0.5)
            sets += [("flat", h, 1.0, m), ("dark", h, 0.0, m)]
        else:
            sets = [("flat", e0, sig(v), 2) for v in vals]
            sets += [("dark", e0, 0.0, 2), ("dark", e0, 0.0, 2), ("flat", e0, 0.5, m), ("dark", e0, 0.0, m)]
        flux_e = cam.range_e * full / e0
    elif layout == "standard":
        lo = sig(r.uniform(0.15, 0.5))
        es = np.geomspace(0.04, 1, 10)
        for e in (sig(e0 * 0.04), e0, long_s):
            sets.append(("dark", e, 0.0, 8))
        for e in es:
            sets.append(("flat", sig(e0 * e), 1.0, 8))
        sets += [("dark", sig(e0 * 0.04), 0.0, 8), ("flat", sig(e0 * 0.5), lo, 8)]
        for e in np.geomspace(0.1, 1, 8):
            sets.append(("flat", sig(e0 * e), lo, 8))
        sets += [("dark", e0, 0.0, 8), ("flat", sig(e0 * 0.5), 1.0, 8), ("flat", sig(e0 * 0.25), 1.0, 8),
                 ("flat", sig(e0 * 0.75), 1.0, 8), ("dark", long_s, 0.0, 8), ("flat", sig(e0 * 0.5), 1.0, 8),
                 ("dark", e0, 0.0, 8)]
        if extra:
            sets[-2] = ("flat", sig(e0 * extra[0]), 1.0, 8)
        sets = sets[:30]
        flux_e = cam.range_e * full / e0
    elif layout == "few":
        p.few_by_light = bool(r.random() < 0.5)
        v4 = [r.uniform(0.05, 0.15), r.uniform(0.25, 0.4), r.uniform(0.5, 0.7), r.uniform(0.85, 1.0)]
        sets = [("flat", e0, sig(v), 8) if p.few_by_light else ("flat", sig(e0 * v), 1.0, 8) for v in v4]
        sets += [("dark", sig(e0 * (1 if p.few_by_light else 0.1)), 0.0, 8), ("dark", long_s, 0.0, 8)]
        flux_e = cam.range_e * full / e0
    else:
        raise SystemExit("unknown layout " + layout)
    if layout not in ("there-and-back", "standard") and r.random() < 0.5:
        r.shuffle(sets)
    p.flux_e_per_s = flux_e                    # electrons per pixel and second at illumination 1 (field mean)
    scale = 1.0
    if layout == "emva-light" and r.random() < 0.5:
        p.illumination_unit = "photons/px/s"
        scale = flux_e / cam.qe
    many_lights = layout in ("light", "grid", "emva-light", "standard") or (layout == "few" and p.few_by_light)
    if many_lights and r.random() < 0.5:
        p.rel_std = 0.002
        scatter = 0.002 * r.uniform(0, 1)
    p.scatter_rel = scatter
    kinds, st, ix, ex, il, tr, ts = [], [], [], [], [], [], []
    gap, set_gap, t = r.uniform(0.01, 0.06), r.uniform(0.0, 2.0), 0.0
    last_level, err = None, 0.0
    for s, (k, e, v, m) in enumerate(sets):
        if k == "flat" and v != last_level:
            err, last_level = scatter * float(np.clip(r.standard_normal(), -2.5, 2.5)), v
        if s == 0 and past:                     # a bright live view before the campaign
            for i in range(past):
                kinds.append("flat"); st.append(0); ix.append(-100); ex.append(e0); il.append(0.0); tr.append(0.7); ts.append(t)
                t += e0 + gap
        for i in range(-lead, m):
            kinds.append(k); st.append(s); ix.append(i); ex.append(e); il.append(sig(v * scale))
            tr.append(sig(v * scale) / scale * (1 + err)); ts.append(t)
            t += e + gap
        t += set_gap
    p.kind = np.array(kinds); p.set = np.array(st); p.index = np.array(ix)
    p.exposure_s = np.array(ex); p.illumination = np.array(il); p.light = np.array(tr)
    p.time_s = np.array(ts); p.duration_s = t
    p.flat = p.kind == "flat"
    p.timestamps = bool(r.random() > 1 / 3)
    p.temperature = "" if r.random() < 0.7 else "%.1f" % r.uniform(25, 45)
    p.sets = sets
    p.frames = len(p.set)
    p.time_s -= p.time_s[p.index >= 0][0]
    p.recorded = np.flatnonzero(p.index >= 0)
    p.unsaved_before_each_set, p.unsaved_before_first = lead, past
    return p


# ------------------------------------------------------------------ effects
class Effect:
    def __init__(s, name, stage, f, lo, hi, shape, expect, near, layouts, need, group, order, names, stats, new, strong):
        s.name, s.stage, s.f, s.lo, s.hi, s.shape = name, stage, f, lo, hi, shape
        s.expect, s.near, s.layouts, s.need, s.group = expect, near, layouts, need, group
        s.memory = group == "memory" or name == "new-mirrored-ghost"
        s.order, s.names, s.stats, s.new, s.strong = order, names, stats, new, strong


EFFECTS = {}


def effect(name, stage, lo, hi, shape=None, expect=None, near=(), layouts=None, need=(), group="", order=50,
           amp="amplitude", stats=None, new=False, always_strong=None):
    # always_strong: range drawn from where even the lowest amplitude is stronger than asked
    """Register f(state, array, amplitude, extra parameters) at a stage. lo..hi: range of the amplitude."""
    def register(f):
        EFFECTS[name] = Effect(name, stage, f, lo, hi, shape, None if new else (expect or name), list(near),
                               layouts, need, group, order, amp, stats, new, always_strong)
        return f
    return register


def new(name, stage, lo, hi, near=(), **k):
    return effect(name, stage, lo, hi, near=near, new=True, **k)


class State:
    """What an effect may see: camera, plan, random numbers, what was made so far."""


def rnd(S, name):
    return stream(S.seed, "effect " + name)


# ---- light: array is (frames,)
@effect("illumination-flicker", "light", 1e-5, 0.2, amp="rel", group="frame")
def _(S, a, A, x):
    return a * (1 + A * rnd(S, "flicker").standard_normal(len(a)))


@effect("illumination-drift", "light", 1e-5, 0.5, amp="rel_over_campaign", group="drift",
        shape=lambda r, c, p: {"sign": int(r.choice([-1, 1]))})
def _(S, a, A, x):
    return a * (1 + x["sign"] * A * S.plan.time_s / S.plan.duration_s)


@effect("illumination-setting", "light", 1e-5, 0.3, amp="rel", layouts=VARIED_LIGHT, group="setting")
def _(S, a, A, x):
    z = rnd(S, "setting").standard_normal(len(S.plan.sets))
    return a * (1 + A * z[S.plan.set])


# ---- field: returns factor (frames or 1, h, w)
def _banding_shape(r, c, p):
    cyc = loguniform(r, 0.002, 0.4)
    line = loguniform(r, 5e-6, 4e-5)
    return {"cycles_per_row": cyc, "line_time_s": line, "ripple_hz": cyc / line,
            "free": loguniform(r, 0.005, 0.3) if r.random() < 0.5 else 0.0}


@effect("light-banding", "field", 1e-4, 0.3, amp="rel", shape=_banding_shape, group="frame")
def _(S, a, A, x):
    p, h = S.plan, S.cam.height
    ph = rnd(S, "banding").uniform(0, 2 * np.pi, p.frames)
    fade = np.sinc(x["ripple_hz"] * p.exposure_s)
    y = np.arange(h)
    g = 1 + A * fade[:, None] * np.sin(2 * np.pi * x["cycles_per_row"] * y[None] + ph[:, None])
    return a * g.astype(F32)[:, :, None]


# ---- exposure: array (frames,) of effective exposures
@effect("exposure-offset", "exposure", 1e-7, 0.01, amp="t0_s", layouts=VARIED_EXPOSURE, group="exposure",
        shape=lambda r, c, p: {"sign": int(r.choice([-1, 1]))})
def _(S, a, A, x):
    t0 = x["sign"] * A
    x["t0_s"] = t0
    return np.maximum(a + t0, 0.02 * a)


# ---- dark: array (frames,1,1) or (frames,h,w) factor on the dark current
@effect("dark-current-drift", "dark", 1e-3, 5.0, amp="rel_over_campaign", layouts=LONG_DARKS, need=("dark",), group="dark",
        shape=lambda r, c, p: {"sign": int(r.choice([-1, 1, 1]))})
def _(S, a, A, x):
    u = S.plan.time_s / S.plan.duration_s
    return a * col(np.exp(x["sign"] * A * u))


# ---- charge: electrons (frames,h,w)
def laplace(q, av, ah):
    """a-weighted sum of (neighbour - pixel), border replicated."""
    out = np.zeros_like(q)
    if av:
        d = np.diff(q, axis=1) * F32(av)
        out[:, :-1] += d
        out[:, 1:] -= d
    if ah:
        d = np.diff(q, axis=2) * F32(ah)
        out[:, :, :-1] += d
        out[:, :, 1:] -= d
    return out


@effect("brighter-fatter", "shot", 1e-9, 2e-4, amp="a0_per_e", shape=lambda r, c, p: {"ratio": r.uniform(0.3, 1.0)},
        group="bf")
def _(S, lam, A, x):
    """Charge in equal steps; in each the light at a pixel times 1 + sum a (q_neighbour - q_own)."""
    av, ah = A, A * x["ratio"]
    x["a1_per_e"] = ah
    steps = 6 if S.exact else 1
    q = np.zeros_like(lam)
    step = lam / F32(steps)
    for k in range(steps):
        d = S.poisson(np.maximum(step * (1 + laplace(q, av, ah)), 0) if k else step)
        # charge that came within the step acts on its second half
        q = q + d + F32(0.5) * step * laplace(d, av, ah)
    return q


@effect("full-well-saturation", "charge", 0.01, 0.7, always_strong=(0.02, 0.3), amp="below_full_scale_rel", group="bend", order=10,
        shape=lambda r, c, p: {"knee_rel": r.uniform(0.75, 0.95)})
def _(S, q, A, x):
    W = S.cam.range_e * (0.99 - A) if A < 0.98 else S.cam.range_e * 0.01
    x["full_well_e"] = W
    k = W * x["knee_rel"]
    return np.where(q < k, q, k + (W - k) * (1 - np.exp(-np.maximum(q - k, 0) / (W - k)))).astype(F32)


@effect("image-lag", "charge", 1e-5, 0.5, amp="fraction", order=20, group="memory")
def _(S, q, A, x):
    """Out = own charge (1 - f) + what was kept from before."""
    out = np.empty_like(q)
    kept = np.zeros_like(q[0])
    for i in range(len(q)):
        out[i] = q[i] * F32(1 - A) + kept
        kept = q[i] * F32(A)
    return out


@effect("interpixel-crosstalk", "charge", 1e-6, 0.15, amp="alpha", order=30, group="near")
def _(S, q, A, x):
    return q + laplace(q, A, A)


@effect("charge-transfer-inefficiency", "charge", 1e-8, 3e-3, amp="loss_per_transfer", order=35, group="near",
        shape=lambda r, c, p: {"axis": "column" if r.random() < 0.6 else "row", "fill_power": float(r.choice([0, 0, 0.3]))})
def _(S, q, A, x):
    """Each transfer leaves the fraction c behind for the packet that follows; c falls where traps fill."""
    ax = 1 if x["axis"] == "column" else 2
    n = np.arange(q.shape[ax], dtype=F32) + 1
    n = n[None, :, None] if ax == 1 else n[None, None, :]
    c = F32(A)
    if x["fill_power"]:
        lev = np.maximum(q.mean(axis=(1, 2), keepdims=True), 5.0)
        c = (A * (lev / (0.1 * S.cam.range_e)) ** -x["fill_power"]).astype(F32)
    lost = q * np.minimum(c * n, 0.5)
    out = q - lost
    if ax == 1:
        out[:, 1:] += lost[:, :-1]
    else:
        out[:, :, 1:] += lost[:, :, :-1]
    return out


@effect("smear", "mean", 1e-8, 0.05, amp="time_s", layouts=VARIED_EXPOSURE, group="exposure")
def _(S, lam, A, x):
    """Light of the whole column falls in during the transfer, whatever the exposure."""
    colmap = (S.cam.field * S.cam.resp).mean(axis=0)
    return lam + col(S.light * S.plan.flux_e_per_s * A) * colmap[None, None, :].astype(F32)


# ---- pixel: electrons with read noise
def _rtn_shape(r, c, p):
    return {"share": loguniform(r, 0.01, 0.08), "switch": 0.5 if r.random() < 0.5 else 0.6}


@effect("random-telegraph-noise", "pixel", 0.5, 20, amp="step_in_read_noise", shape=_rtn_shape, group="pixel",
        stats=("kurtosis", "kurtosis-darks", "kurtosis-low"))
def _(S, v, A, x):
    r = rnd(S, "rtn")
    h, w = S.cam.height, S.cam.width
    pix = np.flatnonzero(r.random(h * w) < x["share"])
    n = len(pix)
    level = r.random(n) < 0.5
    flips = r.random((len(v), n)) < x["switch"]      # probability 1/2 in each frame, or stays with 0.4
    lev = np.logical_xor(np.logical_xor.accumulate(flips, axis=0), level[None])
    x["step_e"] = A * float(np.median(S.cam.read_e))
    out = v.reshape(len(v), -1)
    out[:, pix] += F32(x["step_e"]) * (lev.astype(F32) - F32(0.5))
    return out.reshape(v.shape)


@effect("read-noise-correlation", "pixel", 1e-4, 0.9, amp="a", group="near")
def _(S, v, A, x):
    """The read noise of a pixel contains part of that of the pixel read before (the signal does not)."""
    z = S.z_read
    y = z.copy()
    y[:, :, 1:] += F32(A) * z[:, :, :-1]
    y /= F32(math.sqrt(1 + A * A))
    return v + S.cam.read_e * (y - z)


@effect("row-noise", "pixel", 1e-3, 1e4, amp="e", group="row")
def _(S, v, A, x):
    return v + F32(A) * rnd(S, "row").standard_normal((len(v), v.shape[1], 1), F32)


@effect("column-noise", "pixel", 1e-3, 1e4, amp="e", group="column")
def _(S, v, A, x):
    return v + F32(A) * rnd(S, "column").standard_normal((len(v), 1, v.shape[2]), F32)


# ---- analog: DN above black (dsnu included), after the amplifier
@effect("column-gain-noise", "analog", 1e-6, 0.2, amp="rel", group="column", order=10)
def _(S, v, A, x):
    return v * (1 + F32(A) * rnd(S, "colgain").standard_normal((len(v), 1, v.shape[2]), F32))


@effect("readout-lowpass", "analog", 1e-6, 0.6, amp="a", order=20, group="near",
        shape=lambda r, c, p: {"form": "iir" if r.random() < 0.6 else "fir"})
def _(S, v, A, x):
    """Finite bandwidth along the row: signal and noise of the pixels read before hang over."""
    a = F32(A)
    if x["form"] == "fir":
        out = v.copy()
        out[:, :, 1:] = (1 - a) * v[:, :, 1:] + a * v[:, :, :-1]
        return out
    out = v.copy()
    acc = v[:, :, 0].copy()
    for k in range(1, v.shape[2]):
        acc = (1 - a) * v[:, :, k] + a * acc
        out[:, :, k] = acc
    return out


@effect("gain-drift", "analog", 1e-5, 0.5, amp="rel_over_campaign", group="drift", order=30,
        shape=lambda r, c, p: {"sign": int(r.choice([-1, 1]))})
def _(S, v, A, x):
    return v * col(1 + x["sign"] * A * S.plan.time_s / S.plan.duration_s)


@effect("nonlinearity-square", "analog", 1e-5, 0.6, amp="rel", expect="nonlinearity", group="bend", order=40,
        shape=lambda r, c, p: {"sign": int(r.choice([1, 1, -1]))})
def _(S, v, A, x):
    return v * (1 - F32(x["sign"] * A / S.cam.top) * v)


@effect("nonlinearity-power", "analog", 1e-5, 0.5, amp="one_minus_exponent", expect="nonlinearity", group="bend", order=40,
        need=("shaded",), shape=lambda r, c, p: {"sign": int(r.choice([1, 1, -1]))})
def _(S, v, A, x):
    g = 1 - x["sign"] * A
    x["exponent"] = g
    top = F32(S.cam.top)
    return top * np.sign(v) * (np.abs(v) / top) ** F32(g)


@effect("nonlinearity-two-slope", "analog", 1e-4, 0.7, amp="one_minus_ratio", expect="nonlinearity", group="bend", order=40,
        shape=lambda r, c, p: {"knee_rel": r.uniform(0.25, 0.7)})
def _(S, v, A, x):
    k = F32(x["knee_rel"] * S.cam.top)
    x["knee_dn"] = float(k)
    return v - F32(A) * np.maximum(v - k, 0)


@effect("tap-mismatch", "analog", 1e-4, 0.2, amp="gain_rel", group="tap", order=45,
        shape=lambda r, c, p: {"taps": "halves" if r.random() < 0.5 else "odd-columns", "offset_dn_per_rel": r.uniform(0, 100)})
def _(S, v, A, x):
    m = np.zeros(v.shape[2], bool)
    if x["taps"] == "halves":
        m[v.shape[2] // 2:] = True
    else:
        m[1::2] = True
    out = v.copy()
    off = A * x["offset_dn_per_rel"] * S.cam.noise_dark_dn
    x["offset_dn"] = off
    out[:, :, m] = v[:, :, m] * F32(1 + A) + F32(off)
    return out


# ---- output: DN with black level
@effect("offset-drift", "output", 1e-4, 1000, amp="dn_over_campaign", group="offset",
        shape=lambda r, c, p: {"sign": int(r.choice([-1, 1]))})
def _(S, v, A, x):
    return v + col(x["sign"] * A * S.plan.time_s / S.plan.duration_s)


@effect("offset-noise", "output", 1e-5, 1000, amp="dn", group="offset", near=("offset-drift", "illumination-flicker"))
def _(S, v, A, x):
    return v + col(A * rnd(S, "offset").standard_normal(len(v)))


@effect("periodic-interference", "output", 1e-4, 1000, amp="dn", group="periodic",
        shape=lambda r, c, p: {"cycles_per_column": r.uniform(0.03, 0.45), "cycles_per_row": float(r.choice([0.0, 1.0])) * r.uniform(-0.4, 0.4)})
def _(S, v, A, x):
    n, h, w = v.shape
    ph = rnd(S, "periodic").uniform(0, 2 * np.pi, n)
    base = 2 * np.pi * (x["cycles_per_column"] * np.arange(w)[None, :] + x["cycles_per_row"] * np.arange(h)[:, None])
    s, c = np.sin(base).astype(F32), np.cos(base).astype(F32)
    return v + col(A * np.cos(ph)) * s + col(A * np.sin(ph)) * c


@effect("black-level-clamp", "output", 0.01, 1.0, amp="share_clamped", layouts=LONG_DARKS, need=("dark",), group="dark",
        expect="black-level-clamp", near=("offset-drift", "dark-current-drift", "exposure-offset"))
def _(S, v, A, x):
    """The black of covered pixels is held: the offset falls by their mean dark charge."""
    mean_dark = float(np.median(S.cam.dark)) * S.exposure
    return v - col(A * S.cam.gain * mean_dark)


@effect("black-clipping", "camera", 0.05, 1.6, amp="depth", group="offset",
        stats=("mean", "variance", "variance-less-mean", "kurtosis-darks"))
def _(S, cam, A, x):
    """The black level is set too low: the darks' noise is cut at code 0."""
    spread = math.hypot(cam.noise_dark_dn, float(cam.dsnu_e.std()) * cam.gain)
    x["black_level_dn"] = float(spread * 4 * (1 - A))
    S.black_dn = x["black_level_dn"]


@effect("gamma-whole-code", "output", 0.00001, 0.6, amp="one_minus_exponent", expect="nonlinearity", group="bend", order=90)
def _(S, v, A, x):
    x["exponent"] = 1 - A
    top = F32(S.cam.top)
    return top * (np.maximum(v, 0) / top) ** F32(1 - A)


# ---- adc
@effect("adc-nonlinearity", "adc", 0.003, 8.0, amp="weight_error_dn", group="codes", need=("deep",),
        stats=("codes-folded", "codes", "mean", "variance"))
def _(S, v, A, x):
    """Weights of the five highest bits of ten low-noise ones are off: edges of codes move."""
    cam = S.cam
    r = rnd(S, "adc")
    codes = np.arange(cam.top + 1)
    bits = cam.bit_depth
    high = min(bits, 10)
    first = max(0, bits - high)
    err = np.clip(r.standard_normal(bits), -1.5, 1.5)
    low = max(0, int(round(math.log2(max(cam.noise_dark_dn, 0.5)))))    # bits near the noise and above
    for b in range(bits):
        if b < low or b >= low + 6:
            err[b] = 0.0
    w = A * err
    level = codes.astype(float)
    for b in range(bits):
        level = level + w[b] * ((codes >> b) & 1)
    level -= np.polyval(np.polyfit(codes, level - codes, 1), codes)
    edges = np.maximum.accumulate(level[1:] - 0.5)
    x["weight_errors_dn"] = [round(float(u), 4) for u in w]
    return np.searchsorted(edges.astype(F32), v.ravel(), side="right").reshape(v.shape).astype(F32)


# ---- digital: whole codes
@effect("temporal-filter", "digital", 0.003, 0.8, amp="w", group="memory", order=20, always_strong=(0.004, 0.4),
        shape=lambda r, c, p: {"state": "rounded" if r.random() < 0.5 else "fine"})
def _(S, v, A, x):
    """Now (1 - w) + w sent before, rounded; the state is what was sent, or is kept with its fractions."""
    out = v.copy()
    if x["state"] == "fine":
        for i in range(1, len(v)):
            out[i] = F32(1 - A) * v[i] + F32(A) * out[i - 1]
        return np.floor(out + F32(0.5))
    for i in range(1, len(v)):
        out[i] = np.floor(F32(1 - A) * v[i] + F32(A) * out[i - 1] + F32(0.5))
    return out


@effect("spatial-filter", "digital", 1e-4, 0.25, amp="a", group="near", order=10,
        shape=lambda r, c, p: {"sign": int(r.choice([-1, 1]))})
def _(S, v, A, x):
    """Sharpening (sign 1) or smoothing (sign -1) in the firmware, on codes, border replicated."""
    a = x["sign"] * min(A, 0.12 if x["sign"] < 0 else 0.25)
    return np.floor(v - laplace(v, a, a) + F32(0.5))


def _companding_shape(r, c, p):
    shot_dn = c.gain * math.sqrt(c.range_e)
    return {"top_step_dn": loguniform(r, 2, max(4, 1.5 * shot_dn))}


@effect("companding", "digital", 1, 1, amp="one", group="codes", order=30, need=("deep",), shape=_companding_shape,
        stats=("codes-folded", "variance"))
def _(S, v, A, x):
    """Square-root table to M codes, sent, expanded: steps grow with the root of the level."""
    top = F32(S.cam.top)
    M = x["codes"] = int(round(2 * S.cam.top / x["top_step_dn"]))
    i = np.round(np.sqrt(v / top) * F32(M))
    return np.round((i / F32(M)) ** 2 * top)


@effect("coarse-quantization", "digital", 0.5, 4.5, amp="log2_step", group="codes", order=30, need=("deep",), stats=("codes-folded", "variance"),
        shape=lambda r, c, p: {"form": str(r.choice(["cut", "rounded"]))})
def _(S, v, A, x):
    step = F32(2 ** int(round(A)))
    x["step_dn"] = float(step)
    k = np.floor(v / step) if x["form"] == "cut" else np.minimum(np.floor(v / step + F32(0.5)), np.floor(S.cam.top / step))
    return k * step


@effect("digital-gain", "adc", 0.03, 5, amp="gain_less_1", group="codes", need=("deep",),
        expect="coarse-quantization", always_strong=(0.03, 5), stats=("codes-folded", "variance"),
        shape=lambda r, c, p: {"form": str(r.choice(["cut", "rounded"])), "about": str(r.choice(["zero", "black"]))})
def _(S, v, A, x):
    """Converted in steps of 1 + A and multiplied by it, on the whole code or above the black level."""
    g = x["step_dn"] = 1 + A
    black = round(S.black_dn) if x["about"] == "black" else 0
    out = np.rint((v.astype(float) - black) / g) * g + black
    return np.floor(out if x["form"] == "cut" else out + 0.5).astype(F32)


# ------------------------------------------------------------------ new shapes, in no catalogue
@new("new-noise-power-1.5", "pixel", 1e-5, 10, ())
def _(S, v, A, x):
    z = rnd(S, "n15").standard_normal(v.shape, F32)
    return v + F32(A) * np.maximum(v, 0) ** F32(0.75) * z


@new("new-gain-even-odd-frames", "analog", 1e-6, 0.1, ("illumination-flicker", "gain-drift"))
def _(S, v, A, x):
    return v * col(1 + A * (1 - 2 * (np.arange(len(v)) % 2)))


@new("new-noise-2x2-blocks", "pixel", 1e-3, 1e3, ("interpixel-crosstalk", "readout-lowpass"))
def _(S, v, A, x):
    n, h, w = v.shape
    z = rnd(S, "block").standard_normal((n, (h + 1) // 2, (w + 1) // 2), F32)
    return v + F32(A) * np.repeat(np.repeat(z, 2, 1), 2, 2)[:, :h, :w]


@new("new-breathing-vignette", "field", 1e-5, 0.5, ("illumination-flicker", "illumination-drift"))
def _(S, a, A, x):
    z = col(A * rnd(S, "breath").standard_normal(S.plan.frames))
    m = S.cam.rho2 - S.cam.rho2.mean()
    return a * (1 + z * m)


@new("new-diagonal-noise", "pixel", 1e-3, 1e3, ("row-noise", "column-noise"))
def _(S, v, A, x):
    n, h, w = v.shape
    z = rnd(S, "diag").standard_normal((n, h + w), F32)
    idx = np.arange(h)[:, None] + np.arange(w)[None, :]
    return v + F32(A) * z[:, idx]


@new("new-moving-knee", "analog", 1e-3, 0.8, ("nonlinearity", "gain-drift"))
def _(S, v, A, x):
    k = S.cam.top * (0.3 + 0.4 * S.plan.time_s / S.plan.duration_s)
    return v - F32(A) * np.maximum(v - col(k), 0)


@new("new-column-bend", "analog", 1e-4, 2, ("nonlinearity",))
def _(S, v, A, x):
    c = rnd(S, "colbend").standard_normal((1, 1, v.shape[2])).astype(F32)
    c -= c.mean()
    return v * (1 + F32(A) * c * v / F32(S.cam.top))


@new("new-black-follows-mean", "output", 1e-5, 0.3, ("nonlinearity", "offset-drift"))
def _(S, v, A, x):
    m = v.mean(axis=(1, 2)) - S.black_dn
    return v - col(A * m * m / S.cam.top)


@new("new-despeckle", "digital", 0.1, 1.0, ("spatial-filter",))
def _(S, v, A, x):
    """Firmware clips a pixel to within a limit of its two row neighbours' mean: tails of noise are cut."""
    lim = F32(6 * S.cam.noise_flat_dn * (1.02 - A))
    m = v.copy()
    m[:, :, 1:-1] = 0.5 * (v[:, :, :-2] + v[:, :, 2:])
    return np.round(np.clip(v, m - lim, m + lim))


@new("new-stuck-lsb", "digital", 1e-3, 1, ("adc-nonlinearity", "coarse-quantization"), stats=("codes-folded", "variance"))
def _(S, v, A, x):
    """The lowest bit sticks at 1 in a share of the readings."""
    hit = rnd(S, "lsb").random(v.shape, F32) < A
    return np.where(hit, 2 * np.floor(v / 2) + 1, v).astype(F32)


@new("new-salt-and-pepper", "digital", 1e-5, 0.02, always_strong=(1e-5, 1e-3), near= ("random-telegraph-noise",))
def _(S, v, A, x):
    r = rnd(S, "salt")
    u = r.random(v.shape, F32)
    return np.where(u < A / 2, 0, np.where(u > 1 - A / 2, S.cam.top, v)).astype(F32)


@new("new-row-echo", "analog", 1e-6, 0.3, ("interpixel-crosstalk", "charge-transfer-inefficiency"))
def _(S, v, A, x):
    out = v.copy()
    out[:, 2:] += F32(A) * v[:, :-2]
    return out


@new("new-rotating-gradient", "field", 1e-5, 0.4, ("illumination-flicker",))
def _(S, a, A, x):
    h, w = S.cam.height, S.cam.width
    y, xx = np.mgrid[0:h, 0:w]
    u, v = ((y - h / 2) / h).astype(F32), ((xx - w / 2) / w).astype(F32)
    ph = 0.7 * np.arange(S.plan.frames)
    return a * (1 + col(A * np.cos(ph)) * u + col(A * np.sin(ph)) * v)


@new("new-repeated-rows", "digital", 1e-3, 0.3, ("row-noise",), always_strong=(1e-3, 0.05))
def _(S, v, A, x):
    """In each frame random rows are sent as a copy of the row before."""
    hit = rnd(S, "rows").random(v.shape[:2]) < A
    hit[:, 0] = False
    out = v.copy()
    f, y = np.nonzero(hit)
    out[f, y] = v[f, y - 1]
    return out


@new("new-pink-readout", "pixel", 1e-3, 1e3, ("row-noise", "readout-lowpass"))
def _(S, v, A, x):
    """1/f noise in the order in which the pixels are read."""
    n, h, w = v.shape
    m = h * w
    z = rnd(S, "pink").standard_normal((n, m), F32)
    f = np.fft.rfftfreq(m)
    f[0] = f[1]
    s = np.fft.irfft(np.fft.rfft(z) / np.sqrt(f), m)
    return v + (A * s / s.std()).reshape(v.shape).astype(F32)


@new("new-loud-frames", "pixel", 1e-3, 10, ())
def _(S, v, A, x):
    """One frame in eight is read with more noise."""
    r = rnd(S, "loud")
    hit = r.random(len(v)) < 0.125
    return v + col(A * hit) * S.cam.read_e * r.standard_normal(v.shape, F32)


@new("new-heavy-tails", "pixel", 1e-3, 200, ("random-telegraph-noise",))
def _(S, v, A, x):
    """A share of all readings (any pixel) gets a large error of either sign."""
    r = rnd(S, "tails")
    hit = r.random(v.shape, F32) < 0.003
    return v + F32(A) * S.cam.read_e * hit * r.standard_normal(v.shape, F32)


@new("new-offset-step-in-frame", "output", 1e-4, 1e3, ("row-noise", "offset-drift"))
def _(S, v, A, x):
    r = rnd(S, "step")
    at = r.integers(0, v.shape[1], len(v))
    z = A * r.choice([-1, 1], len(v))
    return v + (z[:, None] * (np.arange(v.shape[1])[None] >= at[:, None])).astype(F32)[:, :, None]


@new("new-row-gain-noise", "analog", 1e-6, 0.1, ("light-banding", "row-noise"))
def _(S, v, A, x):
    return v * (1 + F32(A) * rnd(S, "rowgain").standard_normal((len(v), v.shape[1], 1), F32))


@new("new-pixel-gain-noise", "analog", 1e-5, 0.1, ())
def _(S, v, A, x):
    return v * (1 + F32(A) * rnd(S, "pixgain").standard_normal(v.shape, F32))


@new("new-hysteresis", "output", 1e-3, 30, ("readout-lowpass", "adc-nonlinearity"))
def _(S, v, A, x):
    """The converter's code is low after a higher pixel and high after a lower one."""
    out = v.copy()
    out[:, :, 1:] += F32(A) * np.sign(v[:, :, :-1] - v[:, :, 1:])
    return out


@new("new-echo-eight-columns", "analog", 1e-6, 0.3, ("interpixel-crosstalk", "readout-lowpass"))
def _(S, v, A, x):
    out = v.copy()
    out[:, :, 8:] += F32(A) * v[:, :, :-8]
    return out


@new("new-dark-current-cycle", "dark", 1e-3, 1.0, ("dark-current-drift",), layouts=LONG_DARKS, need=("dark",))
def _(S, a, A, x):
    return a * col(1 + A * np.sin(2 * np.pi * 3.3 * S.plan.time_s / S.plan.duration_s))


@new("new-column-parity-swaps", "analog", 1e-6, 0.1, ("column-gain-noise", "tap-mismatch"))
def _(S, v, A, x):
    c = (1 - 2 * (np.arange(v.shape[2]) % 2))[None, None]
    return v * (1 + col(A * (1 - 2 * (np.arange(len(v)) % 2))) * c).astype(F32)


@new("new-vibration", "field", 1e-3, 8, (), need=("shaded",))
def _(S, a, A, x):
    """The shaded field shakes by fractions of a pixel between frames."""
    z = rnd(S, "shake").standard_normal((2, S.plan.frames))
    f = S.cam.field
    gy, gx = np.gradient(f)
    return a * (1 + (col(A * z[0]) * gy + col(A * z[1]) * gx) / f).astype(F32)


@new("new-exposure-in-steps", "exposure", 1e-7, 3e-3, ("exposure-offset",), layouts=VARIED_EXPOSURE)
def _(S, a, A, x):
    """The exposure is cut to whole steps of the camera's clock."""
    return np.maximum(np.floor(a / A + 1e-9), 1) * A


@new("new-streaking", "output", 1e-5, 0.3, ("row-noise", "nonlinearity"), need=("shaded",))
def _(S, v, A, x):
    """The black of a row falls with the square root of the row's signal (a weak supply)."""
    m = np.maximum(v.mean(axis=2, keepdims=True) - S.black_dn, 0)
    return v - F32(A) * np.sqrt(m * F32(S.cam.top))


@new("new-noise-by-exposure", "pixel", 1e-3, 10, ())
def _(S, v, A, x):
    """Short exposures are read with more noise."""
    e = S.plan.exposure_s
    f = A * np.clip(np.median(e) / e, 0, 4)
    return v + col(f) * S.cam.read_e * rnd(S, "short").standard_normal(v.shape, F32)


@new("new-mirrored-ghost", "charge", 1e-6, 0.3, ("image-lag",), need=("shaded",))
def _(S, q, A, x):
    """A mirrored ghost of the frame before."""
    out = q.copy()
    out[1:] += F32(A) * q[:-1, :, ::-1]
    return out


@new("new-every-third-averaged", "digital", 1e-3, 0.6, ("temporal-filter",))
def _(S, v, A, x):
    out = v.copy()
    i = np.arange(2, len(v), 3)
    out[i] = np.round(F32(1 - A) * v[i] + F32(A) * v[i - 1])
    return out


@new("new-offset-sawtooth-in-time", "output", 1e-4, 1e3, ("offset-drift",))
def _(S, v, A, x):
    u = np.arange(len(v)) / 7.3
    return v + col(A * (u - np.floor(u) - 0.5))


@new("new-noise-louder-to-the-edge", "pixel", 1e-3, 10, ())
def _(S, v, A, x):
    """Extra read noise that is anti-correlated left and right of the centre column."""
    n, h, w = v.shape
    z = rnd(S, "mirror").standard_normal((n, h, w // 2), F32) * F32(A) * float(np.median(S.cam.read_e))
    out = v.copy()
    out[:, :, :w // 2] += z
    out[:, :, w - w // 2:] -= z[:, :, ::-1]
    return out


# ------------------------------------------------------------------ the chain
def fast_poisson(lam, rng, z):
    """Poisson; above 400 by the normal number z with its skewness, rounded (error far below a standard error)."""
    s = np.sqrt(lam)
    q = np.maximum(np.rint(lam + s * z + (z * z - 1) / F32(6)), 0)
    if rng is not None:
        low = lam < 400
        q[low] = rng.poisson(lam[low])
    return q


class Drawer:
    """Draws the same campaign again and again with other effects, from the same random numbers."""

    def __init__(self, seed, cam, plan):
        self.seed, self.cam, self.plan = seed, cam, plan
        shape = (plan.frames, cam.height, cam.width)
        self.z_shot = stream(seed, "shot").standard_normal(shape, F32)
        self.z_read = stream(seed, "read").standard_normal(shape, F32)

    def draw(self, effects, exact):
        """effects: list of (Effect, amplitude, extra); exact: real Poisson numbers. Codes as float32."""
        cam, p = self.cam, self.plan
        S = State()
        S.seed, S.cam, S.plan, S.exact, S.black_dn = self.seed, cam, p, exact, cam.black_dn
        rng = stream(self.seed, "poisson") if exact else None
        zs = stream(self.seed, "shot steps")
        first = [True]

        def poisson(lam):
            z = self.z_shot if first[0] else zs.standard_normal(lam.shape, F32)
            first[0] = False
            return fast_poisson(lam, rng, z)
        S.poisson, S.z_read = poisson, self.z_read

        def stage(name, a):
            for e, A, x in sorted((t for t in effects if t[0].stage == name), key=lambda t: t[0].order):
                r = e.f(S, a, A, x)
                a = a if name == "camera" else r
            return a
        stage("camera", cam)
        S.light = stage("light", p.light.copy()) * p.flat
        field = stage("field", cam.field[None])
        S.exposure = stage("exposure", p.exposure_s.copy())
        dark = stage("dark", np.ones((p.frames, 1, 1), F32))
        lam = col(S.light * S.exposure * p.flux_e_per_s) * (field * cam.resp) + (col(S.exposure) * dark) * cam.dark
        lam = np.maximum(stage("mean", lam.astype(F32)), 0)
        shot = [t for t in effects if t[0].stage == "shot"]
        q = shot[0][0].f(S, lam, shot[0][1], shot[0][2]) if shot else poisson(lam)
        q = stage("charge", q)
        v = stage("pixel", q + cam.read_e * self.z_read)
        v = stage("analog", (v + cam.dsnu_e) * F32(cam.gain))
        v = stage("output", v + F32(S.black_dn))
        adc = [t for t in effects if t[0].stage == "adc"]
        v = adc[0][0].f(S, v, adc[0][1], adc[0][2]) if adc else np.rint(v)
        v = np.clip(v, 0, cam.top)
        v = stage("digital", v)
        self.black_dn = S.black_dn
        return np.clip(v, 0, cam.top)[p.recorded]


# ------------------------------------------------------------------ strength
def statistics(codes, cam, plan):
    """Generic statistics of each set: {name: (values per set (or per bin), standard errors)}; nan where useless."""
    out = {}
    n_sets = len(plan.sets)
    P = cam.height * cam.width
    h, w = cam.height, cam.width

    def put(name, s, value, err):
        a = out.setdefault(name, (np.full(n_sets, np.nan), np.full(n_sets, np.nan)))
        a[0][s], a[1][s] = value, max(err, 1e-12)
    specx, specy, specm, hists, dark_r = [], [], [], np.zeros(32), []
    sat = np.zeros(n_sets, bool)
    for s in range(n_sets):
        x = codes[plan.set[plan.recorded] == s]
        n = len(x)
        k, e, L, _ = plan.sets[s]
        m = x.mean(axis=0, dtype=np.float64).astype(F32)
        sat[s] = (x >= cam.top).mean() > 0.002
        r = x - m
        f = n / (n - 1)
        r2 = r * r
        Vi = r2.sum(axis=0) / (n - 1)
        V = float(Vi.mean())
        V2 = max(V, 0.02)
        dof = P * (n - 1)
        level = float(m.mean())
        light_err = (plan.rel_std or 0.0) * max(level - cam.black_dn, 0) if k == "flat" else 0.0
        frame = r.mean(axis=(1, 2))
        var_frame = float((frame ** 2).sum() / (n - 1))
        put("mean", s, level, math.sqrt(V2 / (P * n) + light_err ** 2))
        put("variance", s, V, V2 * math.sqrt(2 / dof))
        rf = r - frame[:, None, None].astype(F32)
        c = math.sqrt(1 / dof) * V2
        put("cov01", s, f * float((rf[:, :, 1:] * rf[:, :, :-1]).mean()), c)
        put("cov10", s, f * float((rf[:, 1:] * rf[:, :-1]).mean()), c)
        put("cov11", s, f * float((rf[:, 1:, 1:] * rf[:, :-1, :-1]).mean()), c)
        put("cov02", s, f * float((rf[:, :, 2:] * rf[:, :, :-2]).mean()), c)
        put("cov20", s, f * float((rf[:, 2:] * rf[:, :-2]).mean()), c)
        put("cov08", s, f * float((rf[:, :, 8:] * rf[:, :, :-8]).mean()), c)
        put("cov1-1", s, f * float((rf[:, 1:, :-1] * rf[:, :-1, 1:]).mean()), c)
        rows, cols = rf.mean(axis=2), rf.mean(axis=1)
        put("row-means", s, f * float((rows ** 2).mean()), V2 / w * math.sqrt(2 / (h * (n - 1))))
        put("column-means", s, f * float((cols ** 2).mean()), V2 / h * math.sqrt(2 / (w * (n - 1))))
        put("frame-means", s, var_frame, V2 / P * math.sqrt(2 / (n - 1)))
        if n > 2:                               # free of the share that the mean of n frames brings
            put("successive", s, float(np.einsum("ijk,ijk->", r[1:], r[:-1])) / (P * (n - 1)) * f + V / (n - 1), c)
        put("first-frame", s, float(x[0].mean() - x[1:].mean()), math.sqrt(V2 / P * (1 + 1 / (n - 1))))
        u = Vi * Vi / (V2 * V2)                 # relative to the square of the mean variance
        put("variance-less-mean", s, V - cam.gain * level,
            math.sqrt(V2 * V2 * 2 / dof + cam.gain ** 2 * (V2 / (P * n) + light_err ** 2)))
        put("spread", s, float(u.mean()), float(u.std()) / math.sqrt(P) + 1e-9)
        r4 = np.einsum("ijk,ijk->jk", r2, r2) / n
        u = r4 / (V2 * V2)
        put("kurtosis-pooled", s, float(u.mean()), float(u.std()) / math.sqrt(P))
        if n >= 5:
            ku = r4 / np.maximum(Vi, 0.02) ** 2
            put("kurtosis", s, float(ku.mean()), float(ku.std()) / math.sqrt(P))
        fx = (np.abs(np.fft.rfft(rf[:4], axis=2)) ** 2).mean(axis=(0, 1))[1:] / w
        specx.append(fx / (V2 / math.sqrt(h * min(n, 4))))
        fy = (np.abs(np.fft.rfft(rows, axis=1)) ** 2).mean(axis=0)[1:] / h
        specy.append(fy / (V2 / w / math.sqrt(n)))
        fm = (np.abs(np.fft.rfft(cols, axis=1)) ** 2).mean(axis=0)[1:] / w
        specm.append(fm / (V2 / h / math.sqrt(n)))
        if not sat[s]:
            hists += np.bincount((x.ravel().astype(np.int64) % 32), minlength=32)[:32]
        odd = m[:, 1::2].mean() - m[:, 0::2].mean()
        half = m[:, w // 2:].mean() - m[:, :w // 2].mean()
        fixed = (max(level - cam.black_dn, 0) * math.hypot(cam.prnu_col_rel, cam.prnu_rel / math.sqrt(h))
                 + cam.gain * float(cam.dsnu_e.mean(axis=0).std()))
        put("odd-columns", s, float(odd), math.sqrt(4 * V2 / (P * n) + 4 * fixed ** 2 / w * n_sets))
        shading = 0.02 * max(level - cam.black_dn, 0)
        put("halves", s, float(half), math.sqrt(4 * V2 / (P * n) + (4 * fixed ** 2 / w + shading ** 2) * n_sets))
        # fixed pattern: columns' mean against the field (changes with level)
        put("column-pattern", s, float(np.var(m.mean(axis=0))), 2 * np.var(m.mean(axis=0)) * 0.02 + 2 * V2 / (n * h) / math.sqrt(w))
        if k == "dark":
            dark_r.append(r * F32(math.sqrt(f)))
    if dark_r and sum(len(r) for r in dark_r) >= 10:
        d2 = np.concatenate(dark_r) ** 2
        ku = (d2 * d2).mean(axis=0) / np.maximum(d2.mean(axis=0), 0.02) ** 2
        low = np.maximum(2.0 - ku, 0) ** 2      # pixels with two levels
        out["kurtosis-low"] = (np.array([low.mean()]), np.array([low.std() / math.sqrt(P) + 1e-5]))
    out["spectrum-x"] = (np.array(specx), 1)
    out["spectrum-rows"] = (np.array(specy), 1)
    out["spectrum-columns"] = (np.array(specm), 1)
    out["codes-folded"] = (hists, np.sqrt(hists + 1))
    if dark_r:
        d = np.concatenate(dark_r)
        if len(d) >= 6:
            d2 = d * d
            ku = (d2 * d2).mean(axis=0) / np.maximum(d2.mean(axis=0), 0.02) ** 2
            out["kurtosis-darks"] = (np.array([ku.mean()]), np.array([ku.std() / math.sqrt(P)]))
    return out, sat


def compare(base, sat0, other, sat1, plan, only=None):
    """Standard errors by which each statistic moves; free gain, offset, light scale and dark current removed."""
    E = np.array([s[1] for s in plan.sets]); L = np.array([s[2] for s in plan.sets])
    X = np.stack([np.ones_like(E), E * L, E], 1)
    good = ~(sat0 | sat1)
    move = {}
    for name, (v0, e0) in base.items():
        if (only and name not in only) or (not only and name == "codes-folded"):
            continue                            # code occupancy only where it is meant: any shift moves it
        if name not in other:
            continue
        v1 = other[name][0]
        if name.startswith("spectrum"):
            d = np.sqrt(((v1 - v0)[good] ** 2).sum(axis=0))
            move[name] = float(d.max())
            continue
        if name == "codes-folded":
            # all sets pooled; a smooth shift leaves the folded histogram flat
            move[name] = float(np.sqrt((((v1 - v0) / e0) ** 2).sum()) / math.sqrt(2)) if v0.sum() and v1.sum() else 0.0
            continue
        if name in ("kurtosis-darks", "kurtosis-low"):
            move[name] = float(abs(v1 - v0)[0] / e0[0])
            continue
        ok = good & np.isfinite(v0) & np.isfinite(v1)
        if not ok.any():
            continue
        d = ((v1 - v0) / e0)[ok]
        if name in ("mean", "variance", "variance-less-mean"):
            # dark charge must bring its own variance: the third takes no free dark current off
            A = X[ok][:, :2 if name == "variance-less-mean" else 3] / e0[ok][:, None]
            A = A / np.maximum(np.abs(A).max(axis=0), 1e-30)
            d = d - A @ np.linalg.lstsq(A, d, rcond=None)[0]
        move[name] = float(np.sqrt((d ** 2).sum()))
    return move


class Strength:
    def __init__(self, drawer):
        self.d = drawer
        self.base = statistics(drawer.draw([], False), drawer.cam, drawer.plan)

    def moves(self, effects, only=None):
        other = statistics(self.d.draw(effects, False), self.d.cam, self.d.plan)
        return compare(*self.base, *other, self.d.plan, only)

    def solve(self, e, x, target):
        """Amplitude at which the best statistic moves by target; -> (amplitude, reached, statistic)."""
        def value(A):
            m = self.moves([(e, A, x)], e.stats)
            if not m:
                return 0.0, "none"
            k = max(m, key=m.get)
            return m[k], k
        if e.name == "companding":
            return (1.0, *value(1.0))
        if e.name == "coarse-quantization":
            ks = [k for k in (1, 2, 3, 4) if 2 ** k <= self.d.cam.top / 100]
            A = float(stream(self.d.seed, "step").choice(ks))
            return (A, *value(A))
        if e.strong:
            s, k = value(e.lo)
            if s > target:
                A = loguniform(stream(self.d.seed, "strong"), *e.strong)
                return (A, *value(A))
        lo, hi = math.log(e.lo), math.log(e.hi)
        a = lo + 0.55 * (hi - lo)
        best, seen = None, []
        for _ in range(9):
            s, k = value(math.exp(a))
            seen.append((a, s))
            if best is None or abs(math.log(max(s, 1e-3) / target)) < abs(math.log(max(best[1], 1e-3) / target)):
                best = (math.exp(a), s, k)
            if abs(math.log(max(s, 1e-3) / target)) < 0.12:
                break
            if s < target:
                lo = max(lo, a)
            else:
                hi = min(hi, a)
            power = 1.3
            if len(seen) > 1 and seen[-1][0] != seen[-2][0]:
                power = (math.log(max(seen[-1][1], 1e-3)) - math.log(max(seen[-2][1], 1e-3))) / (seen[-1][0] - seen[-2][0])
                power = min(max(power, 0.6), 4.0)
            b = a + (math.log(target) - math.log(max(s, 0.05))) / power
            a = b if lo < b < hi else 0.5 * (lo + hi)
            if hi - lo < 0.02:
                break
        return best


# ------------------------------------------------------------------ one campaign
def compatible(a, b):
    return a.name != b.name and (not a.group or a.group != b.group) and (a.layouts is None or b.layouts is None
                                                        or set(a.layouts) & set(b.layouts))


def choose(kind, seed):
    """Effects of a kind."""
    r = stream(seed, "choose " + kind)
    if kind == "clean":
        return []
    if kind in ("pair", "triple"):
        names = [e for e in EFFECTS.values() if not e.new and e.name not in ("black-level-clamp", "coarse-quantization")]
        got = []
        for i in r.permutation(len(names)):
            lay = [set(g.layouts) for g in got + [names[i]] if g.layouts]
            if all(compatible(g, names[i]) for g in got) and (not lay or set.intersection(*lay)):
                got.append(names[i])
            if len(got) == (2 if kind == "pair" else 3):
                return got
    return [EFFECTS[n] for n in kind.split("+")]


def make(kind, seed, layout=None, strength=15.0):
    """-> codes (uint16), camera, plan, truth."""
    t0 = time.time()
    got = choose(kind, seed)
    need = tuple(n for e in got for n in e.need)
    cam = draw_camera(seed, need)
    if layout is None:
        r = stream(seed, "layout")
        ok = [l for l in LAYOUTS if all(e.layouts is None or l in e.layouts for e in got)]
        layout = str(r.choice(ok))
    plan = draw_plan(seed, cam, layout, any(e.memory for e in got))
    d = Drawer(seed, cam, plan)
    solver = Strength(d) if got else None
    effects, reached = [], {}
    for e in got:
        x = e.shape(stream(seed, "shape " + e.name), cam, plan) if e.shape else {}
        A, s, k = solver.solve(e, x, strength)
        if e.name == "light-banding" and x["free"] > A:
            A = x["free"]
            m = solver.moves([(e, A, x)]); k = max(m, key=m.get); s = m[k]
        effects.append((e, A, x))
        reached[e.name] = {"standard_errors": round(float(s), 2), "statistic": k}
    t1 = time.time()
    codes = d.draw(effects, True).astype(np.uint16)
    missing, near, params = [], [], {}
    for e, A, x in effects:
        if e.new:
            missing.append("unknown"); near += e.near
        elif e.expect not in missing:
            missing.append(e.expect)
            near += e.near
        params[e.expect or e.name] = {"form": e.name, e.names: float(A), **{k: v for k, v in x.items() if k != "free"},
                                     **more_names(e, A, x, plan)}
    truth = {
        "kind": kind, "seed": seed, "layout": layout, "new": any(e.new for e in got),
        "gain_dn_per_e": cam.gain, "black_level_dn": d.black_dn,
        "read_noise_median_e": float(np.median(cam.read_e)), "read_noise_rms_e": float(np.sqrt((cam.read_e.astype(float) ** 2).mean())),
        "dark_e_per_s": float(cam.dark.mean()), "dark_median_e_per_s": float(np.median(cam.dark)),
        "missing": missing, "effects": [e.name for e in got], "near": near, "parameters": params, "strength": reached,
        "nuisances": {"full_well_e": cam.range_e, "read_noise_dn": float(np.median(cam.read_e)) * cam.gain,
                      "read_noise_sigma_log": cam.read_sigma, "noisy_share": cam.noisy_share, "prnu_rel": cam.prnu_rel,
                      "prnu_column_rel": cam.prnu_col_rel, "shading": cam.shading, "dead_pixels": cam.dead_pixels,
                      "flux_e_per_s": plan.flux_e_per_s, "light_scatter_rel": plan.scatter_rel, "duration_s": plan.duration_s,
                      "unsaved_frames_before_each_set": plan.unsaved_before_each_set,
                      "unsaved_bright_frames_before_first": plan.unsaved_before_first,
                      "saturated_share": float((codes >= cam.top).mean()), "quantum_efficiency":
                      cam.qe if plan.illumination_unit != "relative" else None},
        "seconds": {"strength": round(t1 - t0, 2), "draw": round(time.time() - t1, 2)},
    }
    return codes, cam, plan, truth


def tiff_header(h, w):
    """Little-endian TIFF, one strip of 16-bit grey right after the directory."""
    tags = [(256, 4, w), (257, 4, h), (258, 3, 16), (259, 3, 1), (262, 3, 1), (273, 4, 0), (277, 3, 1), (278, 4, h),
            (279, 4, h * w * 2)]
    size = 8 + 2 + 12 * len(tags) + 4
    out = b"II*\0" + struct.pack("<IH", 8, len(tags))
    for tag, typ, val in tags:
        if tag == 273:
            val = size
        out += struct.pack("<HHI", tag, typ, 1) + (struct.pack("<I", val) if typ == 4 else struct.pack("<HH", val, 0))
    return out + struct.pack("<I", 0)


HEADER = "file,kind,set,index,exposure_s,illumination,configuration,temperature_c,timestamp_s"


def write(folder, codes, cam, plan, truth):
    os.makedirs(os.path.join(folder, "frames"), exist_ok=True)
    with open(os.path.join(folder, "dataset.toml"), "w") as f:
        f.write('format = "radcam-dataset/1"\n\n[camera]\nvendor = "cmos.py"\nmodel = "%s"\nserial = "%d"\n'
                'width = %d\nheight = %d\nbit_depth = %d\npixel_format = "Mono%d"\n'
                % ("made camera", truth["seed"], cam.width, cam.height, cam.bit_depth, cam.bit_depth))
        if plan.illumination_unit != "relative" or plan.rel_std:
            f.write('\n[bench]\nillumination_unit = "%s"\n' % plan.illumination_unit)
            if plan.rel_std:
                f.write("illumination_rel_std = %g\n" % plan.rel_std)
    head = tiff_header(cam.height, cam.width)
    rows = [HEADER]
    for j, i in enumerate(plan.recorded):
        name = "frames/s%03d_%02d.tif" % (plan.set[i], plan.index[i])
        with open(os.path.join(folder, name), "wb") as f:
            f.write(head + codes[j].astype("<u2").tobytes())
        rows.append("%s,%s,%d,%d,%.9g,%.9g,0,%s,%s" % (name, plan.kind[i], plan.set[i], plan.index[i], plan.exposure_s[i],
                    plan.illumination[i], plan.temperature, "%.5f" % plan.time_s[i] if plan.timestamps else ""))
    with open(os.path.join(folder, "frames.csv"), "w") as f:
        f.write("\n".join(rows) + "\n")
    with open(os.path.join(folder, "truth.json"), "w") as f:
        json.dump(truth, f, indent=1)


def draw(kind, seed, folder, layout=None, strength=15.0):
    codes, cam, plan, truth = make(kind, seed, layout, strength)
    write(folder, codes, cam, plan, truth)
    return truth


# ------------------------------------------------------------------ scoring
# true value and unit conversions for parameters of the same meaning: truth key -> names the program may use
SAME_MEANING = {
    "illumination-flicker": {"rel": "rel"}, "illumination-setting": {"rel": "rel"}, "column-gain-noise": {"rel": "rel"},
    "light-banding": {"rel": "rel", "cycles_per_row": "cycles_per_row"},
    "row-noise": {"e": "e"}, "column-noise": {"e": "e"}, "image-lag": {"fraction": "fraction"},
    "interpixel-crosstalk": {"alpha": "a"}, "brighter-fatter": {"a0_per_e": "a_vertical_per_e", "a1_per_e": "a_horizontal_per_e"},
    "exposure-offset": {"t0_s": "t0_s"}, "smear": {"time_s": "transfer_s"}, "temporal-filter": {"w": "alpha"},
    "spatial-filter": {"strength": "strength"}, "readout-lowpass": {"iir_alpha": "alpha"},
    "nonlinearity": {"exponent_above_black": "exponent", "knee_dn_above_black": "knee_dn", "ratio": "ratio"},
    "random-telegraph-noise": {"step_e": "amplitude_e", "share": "fraction"},
    "illumination-drift": {"rel_per_s": "rel_per_s"}, "gain-drift": {"rel_per_s": "rel_per_s"}, "offset-drift": {"dn_per_s": "dn_per_s"},
    "periodic-interference": {"dn": "amplitude_dn"}, "tap-mismatch": {"gain_rel": "gain_rel", "offset_dn": "offset_dn"},
    "full-well-saturation": {}, "companding": {"codes": "codes"}, "coarse-quantization": {"step_dn": "step_dn"},
    "offset-noise": {"dn": "dn"},
}


def more_names(e, A, x, plan):
    """Derived truths in other units."""
    if e.name in ("illumination-drift", "gain-drift") and plan.timestamps:
        return {"rel_per_s": x["sign"] * A / plan.duration_s}
    if e.name == "offset-drift" and plan.timestamps:
        return {"dn_per_s": x["sign"] * A / plan.duration_s}
    if e.name == "spatial-filter":
        return {"strength": 4 * x["sign"] * min(A, 0.12 if x["sign"] < 0 else 0.25)}
    if e.name == "readout-lowpass" and x["form"] == "iir":
        return {"iir_alpha": A}
    if e.name == "nonlinearity-power":
        return {"exponent_above_black": x["exponent"]}
    if e.name == "nonlinearity-two-slope":
        return {"knee_dn_above_black": x["knee_dn"], "ratio": 1 - A}
    return {}


def quantity(doc, path):
    for k in path.split("."):
        doc = doc.get(k) if isinstance(doc, dict) else None
    return doc if isinstance(doc, dict) and "value" in doc else None


def tied(entry):
    t = entry.get("tied_with") or []
    return [t] if isinstance(t, str) else [u.get("effect", "") if isinstance(u, dict) else u for u in t]


def score(truth, doc):
    """-> (class of the kind, verdict, number of hidden effects listed, parameter notes)."""
    miss = doc.get("missing") or []
    ids = [m.get("effect", "?") for m in miss]
    silent = bool(doc.get("consistent")) or not ids
    want = truth["missing"]
    first = ids[0] if ids else None
    ok_first = [first] + tied(miss[0]) if miss else []
    for m in miss:                              # an entry that says it is tied with the first
        if first in tied(m):
            ok_first.append(m["effect"])
    listed = sum(1 for w in want if w in ids or w in ok_first)
    notes = []
    for m in miss:
        for key, n in SAME_MEANING.get(m.get("effect"), {}).items():
            true = truth["parameters"].get(m["effect"], {}).get(key)
            q = (m.get("parameters") or {}).get(n)
            if true is not None and isinstance(q, dict) and q.get("std_err"):
                notes.append("%s.%s z=%.1f" % (m["effect"], n, (q["value"] - true) / q["std_err"]))
    if not want:
        return "clean", "consistent" if silent else "alarm", 0, notes
    if truth["new"]:
        v = ("silent" if silent else "unknown" if first == "unknown" else
             "near" if set(ok_first) & set(truth["near"]) else "wrong")
        return "new", v, 0, notes
    cls = "effect" if len(truth["effects"]) == 1 else ("pair" if len(truth["effects"]) == 2 else "triple")
    if silent:
        v = "silent"
    elif set(ok_first) & set(want):
        v = "right"
    elif listed:
        v = "listed"
    elif first == "unknown":
        v = "unknown first"
    elif set(ok_first) & set(truth["near"]):
        v = "near"
    else:
        v = "wrong first"
    return cls, v, listed, notes


def without(doc, folder, truth, args):
    """The hidden effect taken out of the program's catalogue: what stands in its place?

    -> "law": a law leaves an error within 0.03 of the effect's own; "short": a law leaves more; "name": another name
    stands first; "nothing": nothing stands, or `unknown` without a law; "unseen": nor is the effect seen itself.
    """
    if truth["missing"][0] not in [m["effect"] for m in doc.get("missing") or []]:
        return "unseen", []
    run = subprocess.run(["nice", "-n", "10", args["radcam"], "diagnose", folder, "--json", "--without", truth["missing"][0]],
                         capture_output=True, text=True, timeout=args["timeout"])
    other = json.loads(run.stdout)
    ids = [m.get("effect") for m in other.get("missing") or []]
    law = other.get("proposal")
    if law:
        ids.insert(0, "%s (%.3f, own %.3f)" % (law["formulas"], law["error_after"], doc["error_after"]))
        return ("law" if law["error_after"] <= doc["error_after"] + 0.03 else "short"), ids
    return ("name" if ids and ids[0] != "unknown" else "nothing"), ids


def one(job):
    kind, seed, args = job
    folder = os.path.join(args["out"], "%s-%d" % (kind.replace("+", "_"), seed))
    res = {"kind": kind, "seed": seed}
    try:
        truth = draw(kind, seed, folder, args["layout"], args["strength"])
        t = time.time()
        run = subprocess.run(["nice", "-n", "10", args["radcam"], "diagnose", folder, "--json"], capture_output=True,
                             text=True, timeout=args["timeout"])
        res["seconds"] = round(time.time() - t, 2)
        res.update(layout=truth["layout"], truth=truth, exit=run.returncode)
        if run.returncode not in (0, 1):
            res.update(cls="failure", verdict="failure", error=(run.stderr or run.stdout)[-300:])
        elif args.get("without") and len(truth["missing"]) == 1:
            res["cls"], res["verdict"], res["ids"] = "without", *without(json.loads(run.stdout), folder, truth, args)
        else:
            doc = json.loads(run.stdout)
            res["cls"], res["verdict"], res["listed"], res["notes"] = score(truth, doc)
            res["error_before"], res["error_after"] = doc.get("error_before"), doc.get("error_after")
            res["ids"] = [m.get("effect") for m in doc.get("missing") or []]
            res["data_faults"] = [f.get("kind") for f in doc.get("data_faults") or []]
            for path in ("gain_dn_per_e", "model.gain_dn_per_e"):
                q = quantity(doc, path)
                if q and q.get("std_err"):
                    res["gain_z"] = (q["value"] - truth["gain_dn_per_e"]) / q["std_err"]
                    res["gain_ratio"] = q["value"] / truth["gain_dn_per_e"]
            if args["keep"]:
                with open(os.path.join(folder, "diagnose.json"), "w") as f:
                    f.write(run.stdout)
    except Exception as e:                      # a campaign that fails must not stop the others
        res.update(cls="failure", verdict="failure", error=repr(e)[-300:])
    if not args["keep"]:
        shutil.rmtree(folder, ignore_errors=True)
    return res


def kinds_of(text):
    groups = {"clean": ["clean"], "effects": [e.name for e in EFFECTS.values() if not e.new], "pairs": ["pair"],
              "triples": ["triple"], "new": [e.name for e in EFFECTS.values() if e.new]}
    groups["all"] = sum(groups.values(), [])
    out = []
    for k in text.split(","):
        for name in groups.get(k, [k]):
            if name not in ("clean", "pair", "triple") and any(p not in EFFECTS for p in name.split("+")):
                raise SystemExit("unknown kind %s; see: cmos.py list" % name)
            out.append(name)
    return out


def campaign(a):
    os.makedirs(a.out, exist_ok=True)
    kinds = kinds_of(a.kinds)
    jobs = [(k, a.first_seed + i, vars(a)) for i in range(a.n) for k in kinds]
    if len(kinds) > 3:                          # other cameras for other kinds
        jobs = [(k, s + 1000 * (zlib.crc32(k.encode()) % 997), v) for k, s, v in jobs]
    num = lambda v: "%7.2f" % v if isinstance(v, (int, float)) else "      -"
    results = []
    print("%-30s %8s %-15s %-14s %7s %7s %6s  %s" % ("kind", "seed", "layout", "verdict", "before", "after", "s", "first three"))
    from concurrent.futures import ThreadPoolExecutor, ProcessPoolExecutor
    with ProcessPoolExecutor(max_workers=a.jobs) as pool, open(os.path.join(a.out, "results.jsonl"), "a") as log:
        for r in pool.map(one, jobs):
            results.append(r)
            log.write(json.dumps(r) + "\n"); log.flush()
            extra = "" if r.get("gain_z") is None else "  gain z %+.1f (x%.4f)" % (r["gain_z"], r["gain_ratio"])
            if r["cls"] in ("pair", "triple"):
                extra += "  hidden %s, listed %d" % ("+".join(r["truth"]["effects"]), r["listed"])
            if r["cls"] == "new":
                extra += "  near %s" % ",".join(r["truth"]["near"])
            if r.get("data_faults"):
                extra += "  FAULTS %s" % ",".join(r["data_faults"])
            if r.get("notes"):
                extra += "  " + "; ".join(r["notes"])
            print("%-30s %8d %-15s %-14s %s %s %6.1f  %s%s" % (r["kind"], r["seed"], r.get("layout", "-"), r["verdict"],
                  num(r.get("error_before")), num(r.get("error_after")), r.get("seconds", 0),
                  ", ".join(r.get("ids", [])[:3]) or r.get("error", ""), extra), flush=True)
    print("\nsummary")
    table = {}
    for r in results:
        for key in {r["cls"] + " (all)", r["kind"]}:
            t = table.setdefault(key, {})
            t[r["verdict"]] = t.get(r["verdict"], 0) + 1
    for key in sorted(table, key=lambda k: (" (all)" not in k, k)):
        print("  %-34s %3d: %s" % (key, sum(table[key].values()), ", ".join("%s %d" % kv for kv in sorted(table[key].items(), key=lambda kv: -kv[1]))))
    for cls in ("pair", "triple"):
        g = [r for r in results if r["cls"] == cls]
        if g:
            print("  %ss: effects listed %d of %d" % (cls, sum(r["listed"] for r in g), sum(len(set(r["truth"]["missing"])) for r in g)))
    z = np.array([r["gain_z"] for r in results if r.get("gain_z") is not None])
    if len(z):
        print("  gain z: median %+.2f, rms %.2f, beyond 3: %d of %d" % (np.median(z), np.sqrt((z ** 2).mean()), (abs(z) > 3).sum(), len(z)))
    zs = [float(n.rsplit("z=", 1)[1]) for r in results for n in r.get("notes", [])]
    if zs:
        print("  parameters: within 3 standard errors %d of %d" % (sum(abs(v) <= 3 for v in zs), len(zs)))


def main():
    ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    sub = ap.add_subparsers(dest="verb", required=True)
    for verb in ("draw", "strength"):
        d = sub.add_parser(verb)
        d.add_argument("kind"); d.add_argument("seed", type=int)
        if verb == "draw":
            d.add_argument("folder")
        d.add_argument("--layout", choices=LAYOUTS); d.add_argument("--strength", type=float, default=15.0)
    sub.add_parser("list")
    c = sub.add_parser("campaign")
    c.add_argument("--radcam", required=True); c.add_argument("--out", required=True)
    c.add_argument("--kinds", default="clean"); c.add_argument("--n", type=int, default=1)
    c.add_argument("--first-seed", type=int, default=1); c.add_argument("--jobs", type=int, default=2)
    c.add_argument("--keep", action="store_true"); c.add_argument("--layout", choices=LAYOUTS)
    c.add_argument("--strength", type=float, default=15.0); c.add_argument("--timeout", type=float, default=600)
    c.add_argument("--without", action="store_true", help="take the hidden effect out of the catalogue")
    a = ap.parse_args()
    if a.verb == "draw":
        t = draw(a.kind, a.seed, a.folder, a.layout, a.strength)
        print(json.dumps({k: t[k] for k in ("kind", "layout", "missing", "strength", "seconds")}))
    elif a.verb == "strength":
        t = make(a.kind, a.seed, a.layout, a.strength)[3]
        print(json.dumps({k: t[k] for k in ("layout", "strength", "parameters", "seconds")}))
    elif a.verb == "list":
        print("clean\npair\ntriple")
        for e in EFFECTS.values():
            what = "new shape; near: " + (", ".join(e.near) or "none") if e.new else "expects " + e.expect
            print("%-30s %s%s" % (e.name, what, "; layouts " + ", ".join(e.layouts) if e.layouts else ""))
        print("layouts: " + ", ".join(LAYOUTS))
    else:
        campaign(a)


if __name__ == "__main__":
    main()
