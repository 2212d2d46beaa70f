#!/usr/bin/env python3
"""Campaigns of a CMOS camera with exactly one slip of the hand of who measured, with known truth.

Written blind to the program under test, after contract.md; camera, chain and effects are those of cmos.py.

    slips.py draw KIND SEED FOLDER [--layout L]
    slips.py list
    slips.py campaign --radcam PATH --out DIR --kinds all|none|slips|a,b --n N --first-seed S
                      [--jobs 2] [--keep] [--layout L] [--timeout 600]

KIND: none (no slip) or one of the contract's data_faults kinds. The seed fixes everything: the layout is
LAYOUTS[seed % 4] unless given, a campaign has also an effect of the catalogue where seed % 3 == 0 (so twelve
seeds in a row meet every layout with and without effect), the variant of the slip is drawn.

Layouts: exposure (sweep of exposures, some darks), light (sweep of light at one exposure), emva-time (pairs of
flats and darks at each exposure, a spatial block of more frames in most) and descriptor (the same as an EMVA 1288
text file with photons, 16- or 8-bit images; sets are numbered 0.. in the order of its b and d lines).
FOLDER gets the dataset and truth.json; truth "dataset" is what the program is given.

Scores: (a) the slip is named, (b) no innocent set is accused, (c) the effect is first in `missing` (nothing else
is there without one), (d) `noise` gain and read noise, (e) `emva` K: right or refused. A letter with a star
(d*) is a gain that an effect of the campaign moves: shown and counted apart, no failure.
"""
import argparse, json, math, os, re, shutil, struct, subprocess, sys, time
for _v in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_v, "1")
from concurrent.futures import ProcessPoolExecutor
import numpy as np
import cmos
from cmos import F32, col, stream, loguniform

KINDS = ["none", "setting-label", "kind-label", "copied-frames", "dependent-frames", "stale-frame", "odd-frame",
         "other-settings", "unequal-light"]                      # the order enters the seeds: only append
LAYOUTS = ["exposure", "light", "emva-time", "descriptor"]
PAIRS = ["emva-time", "descriptor"]                              # pairs of flats and darks at each exposure
BENDS = ["nonlinearity-square", "nonlinearity-power", "nonlinearity-two-slope"]
EFFECTS = BENDS + ["row-noise", "column-noise", "image-lag", "illumination-flicker", "illumination-drift", "black-clipping",
                   "brighter-fatter", "periodic-interference", "exposure-offset", "interpixel-crosstalk"]
# these act on the levels of frames or sets: the lamp is otherwise perfect
STEADY = BENDS + ["image-lag", "illumination-flicker", "illumination-drift", "exposure-offset", "black-clipping"]
MOVES_GAIN = BENDS + ["image-lag", "brighter-fatter", "interpixel-crosstalk", "black-clipping"]
STRENGTH = 15.0
sig = lambda v: float("%.4g" % v)                                # settings as a person would note them

# ------------------------------------------------------------------ the campaign as it is planned
class Set:
    """What is stated and what was done."""
    def __init__(s, kind, exposure, light, frames):
        s.kind, s.exposure, s.light, s.frames = kind, exposure, light, frames
        s.said_kind, s.said_exposure, s.said_light = kind, exposure, light
        s.said_photons_factor = 1.0                              # descriptor: of the photons of the line
        s.light_factor, s.half = {}, {}                          # frame -> factor; frame -> (axis, from, to, factor)
        s.settings = {}                                          # frame -> (exposure, light) actually used
        s.gain, s.black, s.mirror = 1.0, 0.0, None
        s.average, s.recursive, s.lead = 1, None, 0              # in the camera, before the frames are sent
        s.copies = {}                                            # frame -> (set number, frame)

class Campaign:
    def peak_ok(c, s, factor=1.0):
        return c.level(s) * factor * c.cam.peak < 0.94 * c.cam.range_e
    def level(c, s):
        return c.flux * s.exposure * s.light if s.kind == "flat" else 0.0           # mean electrons by light
    def visible(c, s, change_e):
        var = 2 * (c.level(s) + c.read_rms ** 2 + 1 / (12 * c.cam.gain ** 2))
        return abs(change_e) > 15 * math.sqrt(var / (c.cam.height * c.cam.width))    # of two frame means
    def flats(c, low=0.03):
        """Flat sets of useful level that do not saturate."""
        return [k for k, s in enumerate(c.sets) if s.kind == "flat" and c.peak_ok(s) and c.level(s) > low * c.cam.range_e]
    def darks(c):
        return [k for k, s in enumerate(c.sets) if s.kind == "dark"]
    def some(c, r, pool, n=1):
        return sorted(int(k) for k in r.permutation(pool)[:n])

def pick_camera(cseed, layout, need):
    r = stream(cseed, "which camera")
    depths = (8,) if layout == "descriptor" and r.random() < 0.5 else (10, 12)
    for t in range(1000):
        s = cseed * 1000 + t
        peek = stream(s, "camera")                               # the first numbers that draw_camera draws
        peek.integers(80, 129), peek.integers(80, 129)
        if (8, 10, 12, 14, 16)[peek.integers(5)] in depths:
            cam = cmos.draw_camera(s, need)
            if cam.bit_depth in depths and cam.shading <= 0.35 and cam.noise_dark_dn > 0.5:
                return cam
    raise SystemExit("no camera")

def plan_sets(r, c, kind):
    """Sets in time order, all as they should be."""
    e0, full = c.cam.base_exposure_s, 0.93 / c.cam.peak
    c.flux = c.cam.range_e * full / e0
    c.order = str(r.choice(["ascending", "shuffled", "there-and-back"]))
    over = list(1 + np.cumsum(r.uniform(0.08, 0.25, 2)))
    if c.layout in PAIRS:
        k = int(r.integers(12, 19))
        vals = [sig(e0 * v) for v in list(np.linspace(1 / k, 1, k)) + over]
        groups = [[Set("flat", v, 1.0, 2), Set("dark", v, 0.0, 2)] for v in vals]
        if r.random() < 0.5 and c.order != "there-and-back":     # all flats, then all darks
            groups = [[g[0]] for g in groups] + [[g[1]] for g in groups]
        if c.order == "there-and-back":                          # every other exposure on the way back
            groups = groups[::2] + groups[1::2][::-1]
        elif c.order == "shuffled":
            r.shuffle(groups)
        if r.random() < 0.75:
            m, v = int(r.integers(8, 15)), vals[k // 2]
            groups += [[Set("flat", v, 1.0, m)], [Set("dark", v, 0.0, m)]]
        return [s for g in groups for s in g]
    k = int(r.integers(5, 9)) if c.order == "there-and-back" else int(r.integers(8, 17))
    n = 2 if r.random() < (0.5 if kind == "unequal-light" else 0.08) else int(r.integers(3, 9))
    spaced = np.geomspace(r.uniform(0.02, 0.06), 1, k) if r.random() < 0.5 else np.linspace(1 / k, 1, k)
    spaced = list(spaced) + (over[:1] if r.random() < 0.35 else [])
    by_time = c.layout == "exposure"
    flats = [Set("flat", sig(e0 * v), 1.0, n) if by_time else Set("flat", sig(e0), sig(v), n) for v in spaced]
    twin = lambda s: Set(s.kind, s.exposure, s.light, s.frames)
    long_s = sig(max(4 * e0, r.uniform(0.2, 0.8)))
    es = [sig(e0 * 0.05), sig(e0), long_s] if by_time else [sig(e0), long_s, sig(e0)]
    darks = [Set("dark", e, 0.0, n) for e in es + [sig(e0 * 0.5)] * (r.random() < 0.5)]
    if c.order == "there-and-back":
        return flats + darks + [twin(s) for s in flats[::-1]]
    if kind == "unequal-light" or r.random() < 0.25:             # a set or two are taken again later
        for j in r.choice(np.arange(1, k), 2 if r.random() < 0.4 else 1, replace=False):
            flats.append(twin(flats[int(j)]))
    sets = flats + darks if r.random() < 0.5 else darks + flats
    return [sets[i] for i in r.permutation(len(sets))] if c.order == "shuffled" else sets

def frames_of(c):
    """The plan as cmos.Drawer wants it, every raw frame of it, with what was really done."""
    p = cmos.Plan()
    st, ix, ex, li, ts, t = [], [], [], [], [], 0.0
    for k, s in enumerate(c.sets):
        for i in range(s.lead + s.frames * s.average):
            e, l = s.settings.get(i, (s.exposure, s.light))
            st.append(k); ix.append(i); ex.append(e); ts.append(t)
            li.append(l * (1 + c.scatter_z[k]) * (1 + c.flicker * c.flicker_z[k][i]) * s.light_factor.get(i, 1.0))
            t += e + c.gap
        t += c.set_gap
    p.set, p.index, p.exposure_s, p.light = np.array(st), np.array(ix), np.array(ex), np.array(li)
    p.time_s, p.duration_s, p.frames = np.array(ts), t, len(st)
    p.kind = np.array([c.sets[k].kind for k in st])
    p.flat, p.recorded = np.ones(len(st), bool), np.arange(len(st))     # dark sets have light 0
    p.sets = [(s.kind, s.exposure, s.light, s.lead + s.frames * s.average) for s in c.sets]
    p.layout, p.flux_e_per_s, p.rel_std, p.timestamps = c.layout, c.flux, c.scatter or None, c.timestamps
    return p

# ------------------------------------------------------------------ the slips
# Each changes c.sets and returns (sets, frames as (set, index)), or None where it does not go. c.also: other sets
# with the slip, in which it cannot be seen; c.accept: other kinds that are as right.
def typo(r, v):
    """One digit wrong, or two neighbours swapped, so that the number is wrong by 5 % to a factor of two."""
    text = "%.4g" % v
    at = [i for i, ch in enumerate(text) if ch.isdigit()]
    while True:
        t, i = list(text), int(r.integers(len(at)))
        if r.random() < 0.3 and i + 1 < len(at):
            t[at[i]], t[at[i + 1]] = t[at[i + 1]], t[at[i]]
        else:
            t[at[i]] = str(int(r.integers(10)))
        if 0.5 <= float("".join(t)) / v <= 0.95 or 1.05 <= float("".join(t)) / v <= 2:
            return float("".join(t))

def setting_label(c, r, variant):
    varied = {"exposure": "exposure", "light": "light", "emva-time": "exposure", "descriptor": "photons"}[c.layout]
    what = varied
    if variant in ("factor", "digit") and varied != "photons" and r.random() < 0.35:
        what = "exposure" if varied == "light" else "light"
    value = lambda k: photons(c, c.sets[k]) if what == "photons" else getattr(c.sets[k], what)
    def say(k, v):
        if what == "photons":
            c.sets[k].said_photons_factor = v / value(k)
        else:
            setattr(c.sets[k], "said_" + what, v)
    good = c.flats(0.04)
    k = int(r.choice(good))
    if variant == "factor":
        f = r.uniform(0.5, 0.95) if r.random() < 0.5 else r.uniform(1.05, 2.0)
        if r.random() < 0.4 and what != "photons" and c.peak_ok(c.sets[k], 1 / f):
            setattr(c.sets[k], what, sig(value(k) / f))          # the label is as planned, the setting was not
        else:
            say(k, sig(value(k) * f))
        return [k], []
    if variant == "digit":
        say(k, typo(r, value(k)))
        return [k], []
    others = sorted((j for j in good if abs(value(j) / value(k) - 1) > 0.05), key=lambda j: abs(math.log(value(j) / value(k))))
    if not others:
        return None
    j = others[0] if variant == "neighbour" else int(r.choice(others))
    a, b = value(k), value(j)
    say(k, b)
    if variant == "neighbour":
        return [k], []
    say(j, a)
    return [k, j], []

def kind_label(c, r, variant):
    k = int(r.choice(c.flats(0.08)))
    s = c.sets[k]
    if variant == "cap-on":
        s.kind, s.light = "dark", 0.0                            # stays stated as a flat
        return [k], []
    same = [j for j in c.darks() if c.sets[j].exposure == s.exposure and c.sets[j].frames == s.frames]
    pool = same if c.layout == "descriptor" or (same and r.random() < 0.6) else c.darks()
    if not pool:
        return None
    d = c.sets[c.some(r, pool)[0]]
    s.said_kind, s.said_light, d.said_kind, d.said_light = "dark", 0.0, "flat", s.light
    return sorted([k, c.sets.index(d)]), []

def copied_frames(c, r, variant):
    pool, many = c.flats(0.0), int(r.integers(1, 4))
    if variant == "all-flats":
        pool = [k for k, s in enumerate(c.sets) if s.kind == "flat"]
        many = len(pool)
    else:
        pool = c.darks() if r.random() < 0.2 else pool
        pool = [k for k in pool if (c.sets[k].frames == 2) == (variant == "pair-twice")]
    if not pool:
        return None
    sets, tail = c.some(r, pool, many), int(r.integers(1, 3))
    for k in sets:
        n = c.sets[k].frames
        if variant == "saved-twice":
            c.sets[k].copies = {i: (k, i - 1) for i in range(1, n, 2)}
        else:                                                    # the last one or two are the first again
            c.sets[k].copies = {n - 1 - i: (k, 0) for i in range(tail if n > 3 else 1)}
    return sets, [(k, i) for k in sets for i in sorted(c.sets[k].copies)]

def dependent_frames(c, r, variant):
    sets = c.some(r, c.darks() if r.random() < 0.2 else c.flats(0.02), int(r.choice([1, 1, 2, 3])))
    m, w, lead = int(r.choice([2, 4, 8])), round(float(r.uniform(0.3, 0.7)), 3), int(r.choice([0, 6]))
    for k in sets:
        if variant == "average":
            c.sets[k].average = m
        else:
            c.sets[k].recursive, c.sets[k].lead = w, lead
    c.detail = {"frames_averaged": m} if variant == "average" else {"w": w, "frames_before": lead}
    return sets, [(k, i) for k in sets for i in range(c.sets[k].frames)]

def stale_frame(c, r, variant):
    clip = lambda v: min(v, c.cam.range_e)
    seen, unseen, used = [], [], {}
    for k in range(1, len(c.sets)):
        s, b = c.sets[k], c.sets[k - 1]
        used[k] = (s.exposure if variant == "old-light" else b.exposure, s.light if variant == "old-exposure" else b.light)
        change = clip(c.flux * used[k][0] * used[k][1]) - clip(c.level(s))
        ok = c.visible(s, change) and abs(change) > 0.02 * max(c.level(s), 1)
        (seen if ok or variant == "copy" else unseen).append(k)
    if not seen:
        return None
    c.detail = {"scope": "some" if r.random() < 0.5 else "all"}
    if c.detail["scope"] == "some":
        seen, unseen = c.some(r, seen, max(1, int(round(len(seen) * r.uniform(0.15, 0.5))))), []
    for k in seen + unseen:
        if variant == "copy":
            c.sets[k].copies[0] = (k - 1, c.sets[k - 1].frames - 1)
        else:
            c.sets[k].settings[0] = used[k]
    c.also = unseen
    return seen, [(k, 0) for k in seen]

def odd_frame(c, r, variant):
    f = loguniform(r, max(0.03, 8 * c.flicker_most), 0.5)
    pool = [k for k in c.flats() if c.visible(c.sets[k], f * c.level(c.sets[k]))
            and (variant != "flash" or c.peak_ok(c.sets[k], 1 + f))]
    if c.layout in PAIRS and r.random() < 0.5:                   # the block of more frames, where there is one
        pool = [k for k in pool if c.sets[k].frames > 2] or pool
    pool = c.darks() if variant == "light-in-dark" else pool
    if not pool:
        return None
    k = c.some(r, pool)[0]
    s = c.sets[k]
    i = int(r.integers(s.frames))
    if variant == "light-in-dark":
        s.settings[i] = (s.exposure, loguniform(r, 0.01, 0.2) * c.cam.range_e / c.flux / s.exposure)
        c.detail = {"light": s.settings[i][1]}
    elif variant == "half":
        axis = int(r.integers(2))
        size = (c.cam.height, c.cam.width)[axis]
        cut = int(size * r.uniform(0.25, 0.75))
        a, b = (cut, size) if r.random() < 0.5 else (0, cut)
        s.half[i] = (axis, a, b, 0.0 if r.random() < 0.5 else round(float(r.uniform(0.2, 0.7)), 3))
        c.detail = dict(zip(("axis", "from", "to", "factor"), s.half[i]))
    else:
        s.light_factor[i] = 1 + f if variant == "flash" else 1 - f
        c.detail = {"light_factor": s.light_factor[i]}
    c.accept = ["unequal-light"] if s.frames == 2 else []
    return [k], [(k, i)]

def mirror_seen(c, s, which):
    """The fixed pattern (without its few odd pixels) tells the mirror by 15 standard errors of a correlation."""
    m = c.level(s) * c.cam.field * c.cam.resp + c.cam.dsnu_e + s.exposure * c.cam.dark
    d = m - (m[:, ::-1] if which == "mirror-lr" else m[::-1])
    d = np.clip(d, -7 * np.median(abs(d)), 7 * np.median(abs(d)))
    var = c.level(s) + c.read_rms ** 2 + 1 / (12 * c.cam.gain ** 2)
    return float((d * d).mean()) * s.frames / (2 * var) * math.sqrt(d.size) > 15

def other_settings(c, r, variant):
    dark = r.random() < (0.6 if variant == "black" else 0.25)
    g = float(r.choice([0.5, 0.71, 1.12, 1.26, 1.41, 2.0, 4.0])) if variant == "gain" else 1.0
    b, pool = 0.0, [k for k in c.flats() if c.peak_ok(c.sets[k], g)]
    if variant == "black":
        b = float(loguniform(r, 5, {8: 15, 10: 30}.get(c.cam.bit_depth, 60)) * r.choice([-1, 1]))
        if b < 0:                                                # the noise of the darks stays above code 0
            b = max(b, -(c.cam.black_dn - 6 * c.cam.noise_dark_dn))
            b = abs(b) + 5 if b > -5 or c.effect == "black-clipping" else b
        pool = [k for k in c.flats(0.0) if abs(b) / c.cam.gain > max(0.04, 8 * c.scatter) * c.level(c.sets[k])]
    if dark or not pool:                                         # a lone long dark could as well have more dark charge
        pool = [k for k in c.darks() if c.sets[k].exposure <= 2 * c.cam.base_exposure_s]
    if variant.startswith("mirror"):
        pool = [k for k in pool if mirror_seen(c, c.sets[k], variant)]
    if not pool:
        return None
    k = c.some(r, pool)[0]
    s = c.sets[k]
    s.gain, s.black, s.mirror = g, b, variant if variant.startswith("mirror") else None
    c.detail = {"set_kind": s.kind, "gain_factor": g, "black_change_dn": b}
    return [k], []

def unequal_light(c, r, variant):
    if variant == "repeats":
        groups = {}
        for k in c.flats():
            groups.setdefault((c.sets[k].exposure, c.sets[k].light), []).append(k)
        groups = [g for g in groups.values() if len(g) > 1]
        if not groups:
            return None
        g = groups[int(r.integers(len(groups)))]
        k, d = int(r.choice(g)), loguniform(r, max(0.015, 8 * c.scatter, 8 * c.flicker_most), 0.1)
        f = 1 - d if r.random() < 0.5 else 1 + d
        c.sets[k].light_factor = {i: f for i in range(c.sets[k].frames)}
        c.detail, c.accept = {"light_factor": f, "changed_set": k}, ["setting-label"]
        return g, []
    d, which = loguniform(r, max(0.015, 8 * c.flicker_most), 0.2), int(r.integers(2))
    pool = [k for k in c.flats() if c.sets[k].frames == 2 and c.visible(c.sets[k], d * c.level(c.sets[k]))]
    if not pool:
        return None
    n, at = 1, int(r.integers(len(pool)))
    if variant == "pair":
        c.accept = ["odd-frame"]
    else:                                                        # part of the sweep, in time or by level
        pool = sorted(pool, key=lambda k: c.level(c.sets[k])) if r.random() < 0.5 else pool
        n = max(2, int(len(pool) * r.uniform(0.2, 0.45)))
        at = int(r.integers(max(1, len(pool) - n + 1)))
    sets = sorted(pool[at:at + n])
    for k in sets:
        c.sets[k].light_factor[which] = 1 - d
    c.detail = {"light_factor": 1 - d, "frame": which}
    return sets, [(k, which) for k in sets]

SLIPS = {
    "setting-label": (setting_label, ["factor", "digit", "neighbour", "swapped"]),
    "kind-label": (kind_label, ["exchanged", "cap-on"]),
    "copied-frames": (copied_frames, ["last-is-first", "saved-twice", "pair-twice", "all-flats"]),
    "dependent-frames": (dependent_frames, ["average", "recursive"]),
    "stale-frame": (stale_frame, ["old-exposure", "old-light", "old-both", "copy"]),
    "odd-frame": (odd_frame, ["darker", "flash", "half", "light-in-dark"]),
    "other-settings": (other_settings, ["gain", "black", "mirror-lr", "mirror-ud"]),
    "unequal-light": (unequal_light, ["pair", "part", "repeats"]),
}

# ------------------------------------------------------------------ drawing
class Act:
    """A slip as a link of cmos.Drawer's chain."""
    def __init__(a, stage, f):
        a.stage, a.order, a.f = stage, 5, lambda S, v, A, x: f(v)

def chain_links(c, p):
    each = lambda what: col([getattr(c.sets[k], what) for k in p.set])
    half = np.ones((p.frames, c.cam.height, c.cam.width), F32)
    for j, (k, i) in enumerate(zip(p.set, p.index)):
        if i in c.sets[k].half:
            axis, a, b, factor = c.sets[k].half[i]
            (half[j, a:b] if axis == 0 else half[j, :, a:b])[...] = factor
    acts = []
    if (half != 1).any():
        acts.append(Act("field", lambda v: v * half))
    if (each("gain") != 1).any():
        acts.append(Act("analog", lambda v: v * each("gain")))
    if (each("black") != 0).any():
        acts.append(Act("output", lambda v: v + each("black")))
    return [(a, 0, {}) for a in acts]

def saved(c, p, codes):
    """What the camera sends and the hand saves: list of arrays, one a set."""
    out = []
    for k, s in enumerate(c.sets):
        v = codes[p.set == k]
        if s.average > 1:
            v = np.floor(v.reshape(s.frames, s.average, *v.shape[1:]).mean(axis=1) + F32(0.5))
        if s.recursive:
            w = F32(s.recursive)
            v = v.copy()
            for i in range(1, len(v)):
                v[i] = np.floor(w * v[i - 1] + (1 - w) * v[i] + F32(0.5))
            v = v[s.lead:]
        if s.mirror:
            v = v[:, :, ::-1] if s.mirror == "mirror-lr" else v[:, ::-1]
        out.append(v.astype(np.uint16))
    before = [v.copy() for v in out]
    for k, s in enumerate(c.sets):
        for i, (j, n) in s.copies.items():
            out[k][i] = before[j][n]
    return out

def photons(c, s):
    """Per pixel and exposure, as the lamp was set."""
    return c.flux / c.cam.qe * s.said_light * s.said_exposure

def make(kind, seed, layout=None):
    """-> campaign, frames per set, truth."""
    c, t0 = Campaign(), time.time()
    c.layout = layout or LAYOUTS[seed % len(LAYOUTS)]
    cseed = seed * 100 + KINDS.index(kind)
    r = stream(cseed, "campaign")
    names = [e for e in EFFECTS if e != "exposure-offset" or c.layout != "light"]
    c.effect = names[(seed // 3 + 5 * KINDS.index(kind)) % len(names)] if seed % 3 == 0 else None
    e = cmos.EFFECTS[c.effect] if c.effect else None
    c.cam = pick_camera(cseed, c.layout, e.need if e else ())
    c.read_rms = float(np.sqrt((c.cam.read_e.astype(float) ** 2).mean()))
    c.sets = plan_sets(stream(cseed, "sets"), c, kind)
    c.flicker, c.scatter = [float(r.uniform(0.0003, most)) * (r.random() < 1 / 3) * (c.effect not in STEADY)
                            for most in (0.003, 0.002)]
    z = stream(cseed, "lamp")
    c.scatter_z = [c.scatter * float(np.clip(z.standard_normal(), -2.5, 2.5)) for s in c.sets]
    c.flicker_z = [np.clip(z.standard_normal(8 * s.frames + 8), -3, 3) for s in c.sets]
    c.gap, c.set_gap = float(r.uniform(0.01, 0.06)), float(r.uniform(0, 2))
    c.timestamps = bool(r.random() > 1 / 3)
    c.temperature = "" if r.random() < 0.7 else "%.1f" % r.uniform(25, 45)
    # the effect, of a strength found on the campaign without slip
    links, extra_e = [], 0.0
    p = frames_of(c)
    if e:
        x = e.shape(stream(cseed, "shape"), c.cam, p) if e.shape else {}
        A = float(cmos.Strength(cmos.Drawer(cseed, c.cam, p)).solve(e, x, STRENGTH)[0])
        links.append((e, A, x))
        extra_e = {"row-noise": A, "column-noise": A, "periodic-interference": A / c.cam.gain}.get(e.name, 0.0)
    c.flicker_most = max(c.flicker, A if c.effect == "illumination-flicker" else 0.0)
    # the slip
    c.detail, c.also, c.accept, faults, variant = {}, [], [], [], None
    if kind != "none":
        slip, variants = SLIPS[kind]
        rs = stream(cseed, "slip")
        for variant in map(str, rs.permutation(variants)):
            got = slip(c, rs, variant)
            if got:
                break
        else:
            raise RuntimeError("no %s in %s, seed %d" % (kind, c.layout, seed))
        faults = [{"kind": kind, "sets": [int(k) for k in got[0]], "frames": got[1]}]
    p = frames_of(c)
    drawer = cmos.Drawer(cseed, c.cam, p)
    frames = saved(c, p, drawer.draw(links + chain_links(c, p), True))
    time_of = {(k, i): float(v) for k, i, v in zip(p.set, p.index, p.time_s)}
    keys = [(k, i) for k, s in enumerate(c.sets) for i in range(s.frames)]
    c.times = {(k, i): time_of[(k, c.sets[k].lead + i * c.sets[k].average)] for k, i in keys}
    c.names = {q: "frames/%04d.tif" % j for j, q in enumerate(keys)}
    cam = c.cam
    dark_e = float(cam.dark.mean()) * min(s.exposure for s in c.sets if s.kind == "dark")
    truth = {
        "kind": kind, "variant": variant, "detail": c.detail, "seed": seed, "layout": c.layout, "order": c.order,
        "dataset": "emva.txt" if c.layout == "descriptor" else ".",
        "data_faults": [dict(f, frames=[c.names[q] for q in f["frames"]]) for f in faults], "also": c.also, "accept": [kind] + c.accept,
        "gain_dn_per_e": cam.gain, "black_level_dn": drawer.black_dn,
        "read_noise_median_e": float(np.median(cam.read_e)), "read_noise_rms_e": c.read_rms,
        # upper end of what may be called read noise: with the dark charge of the shortest dark and line noise
        "read_noise_most_e": math.sqrt(c.read_rms ** 2 + dark_e + extra_e ** 2),
        "missing": [e.expect] if e else [], "effect": c.effect,
        "parameters": {e.expect: {"form": e.name, e.names: A, **x}} if e else {},
        "tolerated": (["illumination-flicker"] if c.flicker else []) + (["illumination-setting"] if c.scatter else []),
        "lamp": {"flicker_rel": c.flicker, "scatter_rel": c.scatter},
        "camera": {"bit_depth": cam.bit_depth, "width": cam.width, "height": cam.height, "shading": cam.shading,
                   "range_e": cam.range_e, "read_noise_dn": c.read_rms * cam.gain},
        "sets": [{"done": [s.kind, s.exposure, s.light], "said": [s.said_kind, s.said_exposure, s.said_light,
                  s.said_photons_factor], "frames": s.frames, "level_dn": round(c.level(s) * cam.gain, 2)} for s in c.sets],
        "files": {v: list(k) for k, v in c.names.items()},
        "seconds": round(time.time() - t0, 2)}
    return c, frames, truth

def tiff(image):
    """Little-endian TIFF, one strip of 8- or 16-bit grey."""
    h, w = image.shape
    data = image.tobytes()
    bits = 8 * image.itemsize
    tags = [(256, 4, w), (257, 4, h), (258, 3, bits), (259, 3, 1), (262, 3, 1), (273, 4, 122), (277, 3, 1), (278, 4, h),
            (279, 4, len(data))]
    out = b"II*\0" + struct.pack("<IH", 8, len(tags))
    for tag, typ, val in tags:
        out += struct.pack("<HHI", tag, typ, 1) + (struct.pack("<I", val) if typ == 4 else struct.pack("<HH", val, 0))
    return out + struct.pack("<I", 0) + data                     # 8 + 2 + 9 * 12 + 4 = 122

def write(folder, c, frames, truth):
    shutil.rmtree(os.path.join(folder, "frames"), ignore_errors=True)
    os.makedirs(os.path.join(folder, "frames"))
    cam = c.cam
    for (k, i), name in c.names.items():
        with open(os.path.join(folder, name), "wb") as f:
            f.write(tiff(np.ascontiguousarray(frames[k][i].astype(np.uint8 if cam.bit_depth == 8 else "<u2"))))
    files = {"truth.json": [json.dumps(truth, indent=1)]}
    if c.layout == "descriptor":
        lines = ["# written by slips.py", "v 3.0", "n %d %d %d" % (cam.bit_depth, cam.width, cam.height)]
        for k, s in enumerate(c.sets):
            ns, flat = s.said_exposure * 1e9, s.said_kind == "flat"
            lines.append("b %.1f %.3f" % (ns, photons(c, s) * s.said_photons_factor) if flat else "d %.1f" % ns)
            lines += ["i " + c.names[(k, i)].replace("/", "\\") for i in range(s.frames)]
        files["emva.txt"] = lines
    else:
        files["dataset.toml"] = ['format = "radcam-dataset/1"', "", "[camera]", 'vendor = "slips.py"', 'model = "made camera"',
                                 'serial = "%d"' % truth["seed"], "width = %d" % cam.width, "height = %d" % cam.height,
                                 "bit_depth = %d" % cam.bit_depth, 'pixel_format = "Mono%d"' % cam.bit_depth]
        files["frames.csv"] = [cmos.HEADER] + ["%s,%s,%d,%d,%.9g,%.9g,0,%s,%s" % (
            name, c.sets[k].said_kind, k, i, c.sets[k].said_exposure, c.sets[k].said_light, c.temperature,
            "%.5f" % c.times[(k, i)] if c.timestamps else "") for (k, i), name in c.names.items()]
    for name, lines in files.items():
        with open(os.path.join(folder, name), "w") as f:
            f.write("\n".join(lines) + "\n")

def draw(kind, seed, folder, layout=None):
    c, frames, truth = make(kind, seed, layout)
    write(folder, c, frames, truth)
    return truth

# ------------------------------------------------------------------ running and scoring
WORDS = {"setting-label": "setting-label|stated", "kind-label": "label|exchanged",
         "copied-frames": "copied|copy|copies|identical|same frame|duplicate|twice", "dependent-frames": "dependent|averag|filter",
         "stale-frame": "stale|set before|first frame", "odd-frame": "odd|another level", "unequal-light": "unequal|differ in light",
         "other-settings": "other-settings|black level|gain|orientation|mirror"}

def run(radcam, verb, path, timeout):
    """-> exit code, JSON or None, last words of the log."""
    p = subprocess.run(["nice", "-n", "10", radcam, verb, path, "--json"], capture_output=True, text=True, timeout=timeout)
    doc = json.loads(p.stdout) if p.stdout.lstrip().startswith("{") else None
    return p.returncode, doc, " ".join((p.stderr or p.stdout).split())[-400:]

def accused(entry, truth):
    """Set numbers that an entry of data_faults is about; in descriptors by its frames where it has some."""
    files = {os.path.basename(f): k for f, (k, _) in truth["files"].items()}
    names = [os.path.basename(str(f).replace("\\", "/")) for f in entry.get("frames") or []]
    by_frames = {files[f] for f in names if f in files}
    by_sets = {int(k) for k in entry.get("sets") or []}
    return (by_frames or by_sets) if truth["layout"] == "descriptor" else (by_sets or by_frames)

def score_faults(truth, code, faults, log):
    """-> (verdict, entries against the innocent, text of what was said)."""
    said = [(f.get("kind", "?"), accused(f, truth)) for f in faults]
    text = "; ".join("%s %s" % (k, sorted(s)) for k, s in said) or ("exit 2: " + log[-200:] if code == 2 else "nothing")
    true = set(truth["data_faults"][0]["sets"]) if truth["data_faults"] else set()
    known = true | set(truth["also"])
    wrong = [k for k, s in said if not (s & known) and (s or not true)]
    right = [k for k, s in said if s & true and len(s - known) <= 1]
    if not true:
        v = "refused" if code == 2 else "alarm" if said else "quiet"
    elif any(k in truth["accept"] for k in right):
        v = "named"
    elif right:
        v = "other-kind"
    elif code == 2:
        v = "refused-said" if re.search(WORDS[truth["kind"]], log.lower()) else "refused-mute"
    else:
        v = "missed"
    return v, wrong, text

def score_missing(truth, doc):
    """-> (right, text)."""
    miss, want = doc.get("missing") or [], truth["missing"]
    rest = [m for m in miss if m.get("effect") in want or m.get("effect") not in truth["tolerated"]]
    ok = bool(set([rest[0].get("effect")] + cmos.tied(rest[0])) & set(want)) if want and rest else not want and not rest
    return ok, ",".join(m.get("effect", "?") for m in miss) or "nothing"

def number(doc, key):
    q = (doc or {}).get(key)
    return (float(q["value"]), float(q.get("std_err") or 0)) if isinstance(q, dict) and q.get("value") is not None else None

def score_number(q, low, high, rel):
    """Within 3 standard errors or rel of low..high -> (right, text)."""
    v, s = q
    off, end = max(low - v, v - high, 0.0), low if v < low else high
    return off <= max(3 * s, rel * end), "%.5g+-%.2g true %s" % (v, s, "%.5g" % low if low == high else "%.4g..%.4g" % (low, high))

def one(job):
    kind, seed, a = job
    folder = os.path.join(a["out"], "%s-%d" % (kind, seed))
    res = {"kind": kind, "seed": seed, "fails": [], "said": {}, "ok": {}}
    def judge(letter, name, good, text):
        res["ok"][name], res["said"][name] = good, text
        if good is False:
            res["fails"].append(letter)
    try:
        truth = draw(kind, seed, folder, a["layout"])
        res.update({k: truth[k] for k in ("variant", "layout", "order", "effect", "detail", "data_faults", "tolerated")},
                   draw_s=truth["seconds"])
        path = os.path.join(folder, truth["dataset"]) if truth["dataset"] != "." else folder
        t = time.time()
        out = {v: run(a["radcam"], v, path, a["timeout"])
               for v in ["diagnose", "noise"] + (["emva"] if truth["layout"] in PAIRS else [])}
        res["seconds"], wrong = round(time.time() - t, 2), []
        for v, (code, doc, log) in out.items():
            if code not in (0, 1, 2) or (code != 2 and not doc):
                judge("crash", v + "-run", False, "%s: exit %s: %s" % (v, code, log))
            wrong += [v + " " + k for k in score_faults(truth, code, (doc or {}).get("data_faults") or [], log)[1]]
            if a["keep"]:
                with open(os.path.join(folder, "said-%s.json" % v), "w") as f:
                    json.dump({"exit": code, "log": log, "doc": doc}, f, indent=1)
        code, doc, log = out["diagnose"]
        if code in (0, 1, 2):
            v, _, text = score_faults(truth, code, (doc or {}).get("data_faults") or [], log)
            res["verdict"] = v
            judge("a", "named", None if v == "alarm" else v in ("named", "refused-said", "quiet"), "%s: %s" % (v, text))
            judge("b", "false", not wrong, "%s (diagnose said %s)" % (", ".join(wrong), text))
            if code != 2 and doc:
                judge("c", "missing", *score_missing(truth, doc))
        moved = truth["effect"] in MOVES_GAIN
        code, doc, log = out["noise"]
        g, n, gain = number(doc, "gain_dn_per_e"), number(doc, "read_noise_e"), truth["gain_dn_per_e"]
        res["gain"] = "refused" if code == 2 or g is None else ""
        if not res["gain"]:
            judge("d*" if moved else "d", "gain*" if moved else "gain", *score_number(g, gain, gain, 0.01))
        if code in (0, 1) and n and not moved:
            judge("d", "read", *score_number(n, truth["read_noise_median_e"], truth["read_noise_most_e"], 0.05))
        if "emva" in out and not moved:
            code, doc, log = out["emva"]
            K = number((doc or {}).get("quantities"), "K")
            res["emva"] = "" if code in (0, 1) and K else "refused"
            if not res["emva"]:
                judge("e", "K", *score_number(K, gain, gain, 0.02))
    except Exception as x:                                       # a campaign that fails must not stop the others
        judge("crash", "crash", False, repr(x)[-300:])
    if not a["keep"]:
        shutil.rmtree(folder, ignore_errors=True)
    return res

def describe(r):
    mark = lambda k: {True: "ok", False: "WRONG", None: "-"}[r["ok"].get(k)]
    gain = r.get("gain") or (mark("gain*") + "*" if "gain*" in r["ok"] else mark("gain"))
    return "%-17s %5d %-10s %-13s %-22s %-12s false %-5s missing %-5s gain %-7s read %-5s K %-7s %5.1f s  %s" % (
        r["kind"], r["seed"], r.get("layout", "-"), r.get("variant") or "-", r.get("effect") or "-", r.get("verdict", "-"),
        mark("false"), mark("missing"), gain, mark("read"), r.get("emva") or mark("K"), r.get("seconds", 0), ",".join(r["fails"]))

def campaign(a):
    kinds = [k for t in a.kinds.split(",") for k in {"all": KINDS, "slips": KINDS[1:]}.get(t, [t])]
    assert set(kinds) <= set(KINDS), "kinds: all, slips, " + ", ".join(KINDS)
    os.makedirs(a.out, exist_ok=True)
    jobs = [(k, a.first_seed + i, vars(a)) for i in range(a.n) for k in kinds]
    results = []
    with ProcessPoolExecutor(max_workers=a.jobs) as pool, open(os.path.join(a.out, "results.jsonl"), "a") as log:
        for r in pool.map(one, jobs):
            results.append(r)
            log.write(json.dumps(r) + "\n"); log.flush()
            print(describe(r), flush=True)
            if r["fails"]:
                print("    " + " | ".join("%s: %s" % (k, r["said"][k]) for k, v in r["ok"].items() if v is False))
                print("    truth: %s %s, sets %s, order %s, effect %s, lamp %s\n    again: slips.py draw %s %d DIR --layout %s" % (
                      r.get("variant"), json.dumps(r.get("detail")), [f["sets"] for f in r.get("data_faults", [])], r.get("order"),
                      r.get("effect"), r.get("tolerated"), r["kind"], r["seed"], r.get("layout")), flush=True)
    summary(results)
    return 1 if any(f != "d*" for r in results for f in r["fails"]) else 0

def summary(results):
    print("\nsummary (right of those that could be judged; gain*: an effect of the campaign moves it)")
    heads = ["named", "other-kind", "missed", "refused-said", "refused-mute", "refused", "alarm"]
    parts = ["false", "missing", "gain", "gain*", "read", "K"]
    row = "%-17s %4s" + " %12s" * len(heads) + " %8s" * len(parts) + " %7s %5s"
    print(row % ("kind", "n", *heads, "innocent", *parts[1:], "no gain", "crash"))
    for kind in KINDS + ["all"]:
        rs = [r for r in results if kind in (r["kind"], "all")]
        part = lambda k: "%d/%d" % (sum(r["ok"].get(k) is True for r in rs), sum(r["ok"].get(k) is not None for r in rs))
        if rs:
            print(row % (kind, len(rs), *[sum(r.get("verdict") == h for r in rs) for h in heads], *map(part, parts),
                         sum(r.get("gain") == "refused" for r in rs), sum("crash" in r["fails"] for r in rs)))
    for kind in KINDS[1:]:
        rs = [r for r in results if r["kind"] == kind and r.get("variant")]
        named = {v: [r["ok"].get("named") is True for r in rs if r["variant"] == v] for v in SLIPS[kind][1]}
        if rs:
            print("  %-17s %s" % (kind, ", ".join("%s %d/%d" % (v, sum(n), len(n)) for v, n in named.items())))

def main():
    ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    sub = ap.add_subparsers(dest="verb", required=True)
    d, c = sub.add_parser("draw"), sub.add_parser("campaign")
    sub.add_parser("list")
    d.add_argument("kind", choices=KINDS); d.add_argument("seed", type=int); d.add_argument("folder")
    for flag in ("--radcam", "--out"):
        c.add_argument(flag, required=True)
    c.add_argument("--kinds", default="all"); c.add_argument("--keep", action="store_true")
    for flag, default in (("--n", 1), ("--first-seed", 1), ("--jobs", 2), ("--timeout", 600)):
        c.add_argument(flag, type=int, default=default)
    for v in (d, c):
        v.add_argument("--layout", choices=LAYOUTS)
    a = ap.parse_args()
    if a.verb == "draw":
        t = draw(a.kind, a.seed, a.folder, a.layout)
        print(json.dumps({k: t[k] for k in ("kind", "variant", "detail", "layout", "order", "effect", "data_faults", "seconds")}))
    elif a.verb == "list":
        print("\n".join("%-17s %s" % (k, ", ".join(SLIPS[k][1]) if k in SLIPS else "no slip") for k in KINDS))
        print("layouts: %s\neffects: %s" % (", ".join(LAYOUTS), ", ".join(EFFECTS)))
    else:
        sys.exit(campaign(a))

if __name__ == "__main__":
    main()
