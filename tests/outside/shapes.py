#!/usr/bin/env python3
"""Twenty more shapes that are in no catalogue: what real cameras, lamps and firmware do.

Adds to the generator cmos.py (same camera, same chain, same strength) and runs only its own shapes:

    shapes.py list
    shapes.py strength NAME SEED                  (amplitude, and which statistic sees it)
    shapes.py draw NAME SEED FOLDER
    shapes.py campaign --radcam PATH --out DIR --n N --first-seed S [--jobs 2] [--keep]

Each shape's docstring says in one line which statistic it changes, how this scales, and along which
axis. A name in the list `near` is one that a reasonable expert would accept as "mostly like this".
cmos.py measures strength by temporal statistics; a shape that moves only the fixed pattern would look
weak to them. One more statistic is therefore added here: "pattern", the misfit of each pixel's set
means to a straight line of that pixel in the level and the exposure time.
"""
import argparse, json, math
import cmos
from cmos import F32, LONG_DARKS, VARIED_EXPOSURE, col, loguniform, rnd
import numpy as np

SHAPES = []
_plain_statistics = cmos.statistics


def statistics(codes, cam, plan):
    """cmos.statistics and "pattern": (set mean of a pixel - the pixel's line)^2 over its noise, mean of pixels."""
    out, sat = _plain_statistics(codes, cam, plan)
    of_frame, good = plan.set[plan.recorded], np.flatnonzero(~sat)
    values = np.full(len(plan.sets), np.nan)
    if len(good) > 3:
        X, Y = [], []
        for s in good:
            m = codes[of_frame == s].mean(axis=0, dtype=np.float64).ravel()
            tol = math.sqrt(max(out["variance"][0][s], 0.02) / (of_frame == s).sum())
            X.append(np.array([1.0, m.mean(), plan.sets[s][1]]) / tol)
            Y.append(m / tol)
        X, Y = np.array(X), np.array(Y)
        X /= np.abs(X).max(axis=0)
        R = Y - X @ np.linalg.lstsq(X, Y, rcond=None)[0]
        values[good] = np.minimum(R * R, 25).mean(axis=1)
    out["pattern"] = (values, np.full(len(plan.sets), math.sqrt(2 / (cam.height * cam.width))))
    return out, sat


cmos.statistics = statistics


def new(name, stage, lo, hi, near=(), **k):
    """cmos.new, and remember the name."""
    SHAPES.append(name)
    return cmos.new(name, stage, lo, hi, near, **k)


def elapsed(S):
    """Per frame: 0 at the start of the campaign, 1 at its end."""
    return S.plan.time_s / S.plan.duration_s


# ------------------------------------------------------------------ lamp and exposure
@new("new-two-lamps-two-ripples", "field", 1e-5, 0.4, ("illumination-flicker",),
     shape=lambda r, c, p: {"left_hz": r.uniform(95, 105), "right_hz": loguniform(r, 110, 400)})
def _(S, a, A, x):
    """Frame means and left-right contrast scatter; amplitude power 1, falls as sinc(f T); along the rows."""
    across = np.linspace(0, 1, S.cam.width, dtype=F32)
    g = 0
    for hz, w in ((x["left_hz"], 1 - across), (x["right_hz"], across)):
        wave = np.sinc(hz * S.plan.exposure_s) * np.sin(2 * np.pi * hz * (S.plan.time_s + S.plan.exposure_s / 2))
        g = g + col(A * wave) * w
    return a * (1 + g)


@new("new-interlaced-fields", "field", 1e-5, 0.4, ("light-banding",))
def _(S, a, A, x):
    """Odd rows brighter and even rows darker, by turns at random; variance power 2; down the columns."""
    parity = (1 - 2 * (np.arange(S.cam.height) % 2)).astype(F32)[None, :, None]
    return a * (1 + col(A * rnd(S, "fields").standard_normal(S.plan.frames)) * parity)


@new("new-shutter-jitter", "exposure", 1e-8, 0.01, ("illumination-flicker", "exposure-offset"), layouts=VARIED_EXPOSURE)
def _(S, a, A, x):
    """Frame means scatter by flux times a constant time: power 0 in the exposure, 1 in the flux; whole frame."""
    return np.maximum(a + A * rnd(S, "shutter").standard_normal(len(a)), 0.02 * a)


@new("new-odd-rows-exposed-longer", "mean", 1e-8, 0.05, ("exposure-offset", "tap-mismatch"), layouts=VARIED_EXPOSURE)
def _(S, lam, A, x):
    """Mean of odd rows rises by flux times a constant time, whatever the exposure; down the columns."""
    odd = (np.arange(S.cam.height) % 2).astype(F32)[:, None]
    return lam + col(S.light * S.plan.flux_e_per_s * A) * (odd * S.cam.field * S.cam.resp)


@new("new-light-leak-grows", "mean", 1e-3, 1e4, ("dark-current-drift", "offset-drift"), layouts=LONG_DARKS,
     shape=lambda r, c, p: {"side": int(r.choice([-1, 1])), "reach_rel": r.uniform(0.1, 0.5)})
def _(S, lam, A, x):
    """Means of darks and flats rise with exposure times campaign time (with shot noise); fades from one side."""
    far = np.linspace(0, 1, S.cam.width, dtype=F32)[::x["side"]]
    return lam + col(S.exposure * A * S.cam.dark_mean * elapsed(S)) * np.exp(-far / F32(x["reach_rel"]))


# ------------------------------------------------------------------ in the pixel and its amplifier
@new("new-noise-jump-at-gain-switch", "pixel", 1e-2, 50, (), shape=lambda r, c, p: {"switch_rel": r.uniform(0.15, 0.5)})
def _(S, v, A, x):
    """Variance steps up by a constant in every pixel above the switch to the low gain; mean stays; no axis."""
    z = rnd(S, "switch").standard_normal(v.shape, F32)
    return v + F32(A * float(np.median(S.cam.read_e))) * z * (v > F32(x["switch_rel"] * S.cam.range_e))


@new("new-reset-noise-comes-back", "pixel", 1e-3, 10, ("temporal-filter",))
def _(S, v, A, x):
    """Covariance of successive frames is negative, variance up; power 0, darks alike; along time."""
    z = rnd(S, "reset").standard_normal((len(v) + 1,) + v.shape[1:], F32)
    return v + F32(A) * S.cam.read_e * np.diff(z, axis=0)


@new("new-noise-warms-up", "pixel", 1e-3, 20, ())
def _(S, v, A, x):
    """Read-noise variance rises with the square of the campaign's time, at every level alike; along time."""
    return v + col(A * elapsed(S)) * S.cam.read_e * rnd(S, "warm").standard_normal(v.shape, F32)


@new("new-clamp-wanders-down-the-rows", "pixel", 1e-3, 1e3, ("row-noise",),
     shape=lambda r, c, p: {"kept_per_row": r.uniform(0.8, 0.96)})
def _(S, v, A, x):
    """Row means scatter and neighbouring rows alike (a clamp that averages rows); power 0; down the columns."""
    k = x["kept_per_row"]
    z = rnd(S, "clamp").standard_normal(v.shape[:2])
    for y in range(1, z.shape[1]):
        z[:, y] = k * z[:, y - 1] + math.sqrt(1 - k * k) * z[:, y]
    return v + (A * z).astype(F32)[:, :, None]


@new("new-column-telegraph", "pixel", 1e-2, 1e3, ("column-noise", "random-telegraph-noise"),
     shape=lambda r, c, p: {"share": r.uniform(0.03, 0.1)})
def _(S, v, A, x):
    """Variance of the means of a few columns, which jump between two levels; power 0; along the rows."""
    r = rnd(S, "column telegraph")
    sick = r.permutation(v.shape[2])[:max(3, int(x["share"] * v.shape[2]))]
    out = v.copy()
    out[:, :, sick] += F32(A) * (r.integers(0, 2, (len(v), 1, len(sick))) - F32(0.5))
    return out


# ------------------------------------------------------------------ analog read-out
@new("new-pixels-bend-differently", "analog", 1e-4, 3, ("nonlinearity",))
def _(S, v, A, x):
    """Pattern (PRNU) grows with the square of the level around an unmoved mean; each pixel its own, no axis."""
    c = rnd(S, "bends").standard_normal((1,) + v.shape[1:], F32)
    return v * (1 + F32(A) * (c - c.mean()) * v / F32(S.cam.top))


@new("new-pixel-gains-walk", "analog", 1e-5, 0.5, ("gain-drift",))
def _(S, v, A, x):
    """Pattern (PRNU) changes with the campaign's time, power 1, around an unmoved mean; no axis."""
    c = rnd(S, "walk").standard_normal((1,) + v.shape[1:], F32)
    return v * (1 + col(A * elapsed(S)) * (c - c.mean()))


@new("new-auto-gain-late", "analog", 1e-5, 1.0, ("nonlinearity", "image-lag"), group="memory")
def _(S, v, A, x):
    """First frame after a change of level is off and the settled mean bends, gain with it; power 2; along time."""
    out = np.empty_like(v)
    sent = float(v[0].mean())
    for i in range(len(v)):
        out[i] = v[i] * F32(max(1 - A * (sent / S.cam.top - 0.4), 0.1))
        sent = float(out[i].mean())
    return out


@new("new-row-clock-jitter", "analog", 1e-3, 1.5, ("readout-lowpass",))
def _(S, v, A, x):
    """Variance at steep pattern (power 2), neighbours blurred, both by rows at random; along the rows."""
    j = np.clip(A * rnd(S, "jitter").standard_normal((len(v), v.shape[1], 1)), -0.95, 0.95).astype(F32)
    out = v.copy()
    d = np.diff(v, axis=2)
    out[:, :, :-1] += np.maximum(j, 0) * d
    out[:, :, 1:] -= np.maximum(-j, 0) * d
    return out


@new("new-tile-gain-noise", "analog", 1e-6, 0.3, ())
def _(S, v, A, x):
    """Variance and short covariances inside 4x4 tiles (not across their edges) rise; power 2; both axes."""
    n, h, w = v.shape
    z = rnd(S, "tiles").standard_normal((n, (h + 3) // 4, (w + 3) // 4), F32)
    return v * (1 + F32(A) * np.repeat(np.repeat(z, 4, 1), 4, 2)[:, :h, :w])


# ------------------------------------------------------------------ converter and firmware
@new("new-stale-dark-correction", "output", 1e-4, 1e3, ("offset-drift", "dark-current-drift"))
def _(S, v, A, x):
    """Dark pattern is subtracted more and more over the campaign, mean unmoved; power 0 and all exposures; no axis."""
    z = (S.cam.dark - np.median(S.cam.dark)) / np.percentile(S.cam.dark, 90)
    z = np.clip(z, -4, 4)
    return v - col(A * elapsed(S)) * (z - z.mean())


@new("new-moving-dither", "output", 1e-3, 1e3, ("periodic-interference",))
def _(S, v, A, x):
    """Variance up by a 4x4 ordered dither shifted at random each frame; power 0; both axes, period 4."""
    b = np.array([[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]], F32) / 15 - F32(0.5)
    shift = rnd(S, "dither").integers(0, 4, (len(v), 2))
    out = v.copy()
    for i, (dy, dx) in enumerate(shift):
        y, c = (np.arange(v.shape[1]) + dy) % 4, (np.arange(v.shape[2]) + dx) % 4
        out[i] += F32(A) * b[y][:, c]
    return out


@new("new-digital-gain-comb", "adc", 3, 5, ("adc-nonlinearity", "coarse-quantization", "companding"),
     amp="log2_period", stats=("codes-folded", "variance"), always_strong=(3, 5))
def _(S, v, A, x):
    """Occupancy: one code in k never occurs (converted coarser, stretched by k/(k-1)); all levels; no axis."""
    k = 2 ** int(round(A))
    x["period_codes"] = k
    coarse = np.rint(v * F32((k - 1) / k))
    return np.rint(coarse * F32(k / (k - 1)))


@new("new-lossy-blocks", "digital", 1e-2, 1e3, ("spatial-filter", "coarse-quantization"))
def _(S, v, A, x):
    """Fine noise inside 8x8 blocks is rounded away (JPEG): variance and covariances, below a level; both axes."""
    n, h, w = v.shape
    k = np.arange(8)
    D = np.cos(np.pi * (2 * k[None] + 1) * k[:, None] / 16) * np.where(k == 0, math.sqrt(1 / 8), 0.5)[:, None]
    D = D.astype(F32)
    step = (A * (1 + 0.25 * (k[:, None] + k[None]))).astype(F32)
    p = np.pad(v, ((0, 0), (0, -h % 8), (0, -w % 8)), mode="edge")
    B = p.reshape(n, p.shape[1] // 8, 8, p.shape[2] // 8, 8).transpose(0, 1, 3, 2, 4)
    q = np.rint((D @ B @ D.T) / step) * step
    out = (D.T @ q @ D).transpose(0, 1, 3, 2, 4).reshape(p.shape)
    return np.rint(out[:, :h, :w])


@new("new-defect-list-neighbours", "digital", 1e-4, 0.5, ("spatial-filter", "readout-lowpass"))
def _(S, v, A, x):
    """Listed pixels send their neighbours' mean: half the variance and high covariance there; along the rows."""
    listed = rnd(S, "list").random(v.shape[1:], F32) < A
    m = v.copy()
    m[:, :, 1:-1] = np.floor(0.5 * (v[:, :, :-2] + v[:, :, 2:]) + F32(0.5))
    return np.where(listed, m, v)


# ------------------------------------------------------------------ command line
def main():
    ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    sub = ap.add_subparsers(dest="verb", required=True)
    sub.add_parser("list")
    for verb in ("draw", "strength"):
        d = sub.add_parser(verb)
        d.add_argument("kind", choices=SHAPES); d.add_argument("seed", type=int)
        if verb == "draw":
            d.add_argument("folder")
    c = sub.add_parser("campaign")
    c.add_argument("--radcam", required=True); c.add_argument("--out", required=True)
    c.add_argument("--n", type=int, default=1); c.add_argument("--first-seed", type=int, default=1)
    c.add_argument("--jobs", type=int, default=2); c.add_argument("--keep", action="store_true")
    c.add_argument("--kinds", default=",".join(SHAPES), help="only these of the shapes, with commas")
    for p in sub.choices.values():
        p.add_argument("--layout", choices=cmos.LAYOUTS); p.add_argument("--strength", type=float, default=15.0)
        p.add_argument("--timeout", type=float, default=600)
    a = ap.parse_args()
    if a.verb == "list":
        for name in SHAPES:
            e = cmos.EFFECTS[name]
            print("%-32s near: %s\n    %s" % (name, ", ".join(e.near) or "none", e.f.__doc__))
    elif a.verb == "draw":
        t = cmos.draw(a.kind, a.seed, a.folder, a.layout, a.strength)
        print(json.dumps({k: t[k] for k in ("kind", "layout", "near", "strength", "seconds")}))
    elif a.verb == "strength":
        t = cmos.make(a.kind, a.seed, a.layout, a.strength)[3]
        print(json.dumps({k: t[k] for k in ("layout", "strength", "parameters", "seconds")}))
    else:
        cmos.campaign(a)


if __name__ == "__main__":
    main()
