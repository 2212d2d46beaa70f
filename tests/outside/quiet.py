#!/usr/bin/env python3
"""Draw campaigns of a CMOS camera with one mistake that nobody noted.

    quiet.py OUT --kind KIND --seed SEED        one campaign: OUT/data (frames), OUT/truth.json, OUT/test.tif + .npy
    quiet.py --list                             kinds
    quiet.py OUT --campaign --radcam R --n N --seed FIRST [--kind KIND]
                                                N campaigns of each kind as datasets through `noise` and `diagnose`

Layout by seed: 0 exposure sweep with darks at each exposure, 1 the same with darks at three exposures, 2 light sweep at one
exposure, 3 EMVA 1288 pairs and stacks, 4 and 5 three configurations for a flat-field calibration; then again. Odd or even
seeds (by kind) are a folder of named files, the others a dataset with manifest; --form overrides. Needs numpy and tifffile.
OUT/test.tif is one further frame of the sound camera (scene: smooth light) for `correct`, OUT/test.npy the DN above black
that an ideal camera would give, the true PRNU, the sound pixels, offset (DN) and dark signal (DN/s). Nothing in names or headers tells the mistake; truth.json does.

Of a campaign is counted, for gain and read noise: right (within 3 standard errors or 2 %), not given, refused or said (exit 1 or 2,
a data fault, or a note), WRONG (exit 0, and nothing said); and the names that diagnose gives without a data fault.
"""
import argparse, json, os, shutil, struct, subprocess, sys, zlib
import numpy as np, tifffile

W, H, TOP = 160, 120, 4095
KINDS = ("dark-gain dark-black dark-other-camera dark-long dark-swapped dim-flats-as-dark subtracted eight-bit turned digital-gain "
         "auto-exposure auto-gain stretch stamp dust leak warm-up jpeg unit-mix exposure-step binned denoised clean "
         "dark-bits shading-corrected subtracted-long nominal darks-smoothed led").split()
LAYOUTS = "sweep sweep3 light emva calib calib".split()


class Camera:
    def __init__(s, r):
        s.K = float(np.exp(r.uniform(np.log(0.2), np.log(4))))           # DN/e-
        med = r.uniform(2, 8)
        s.read = med * np.exp(r.normal(0, 0.2, (H, W)))                  # e-, lognormal over pixels
        s.prnu = r.normal(0, r.uniform(0.005, 0.015), (H, W))
        s.dsnu = r.normal(0, r.uniform(1, 4), (H, W))                    # e-
        s.black = float(r.uniform(60, 300))                              # DN
        s.black = max(s.black, 6 * s.K * (med + s.dsnu.std()) + 20)
        s.dark_rate = r.uniform(60, 400)                                 # e-/s
        s.dark = s.dark_rate * np.exp(r.normal(0, 0.3, (H, W)))
        y, x = np.mgrid[0:H, 0:W]
        cx, cy, a = r.uniform(0.35, 0.65) * W, r.uniform(0.35, 0.65) * H, r.uniform(0.1, 0.3)
        s.shade = 1 - a * ((x - cx) ** 2 + (y - cy) ** 2) / (W / 2) ** 2 / 1.5
        s.shade /= s.shade.mean()
        at = r.choice(W * H, 8, replace=False)
        s.dark.flat[at[:5]] *= r.uniform(30, 300, 5)                     # hot
        s.prnu.flat[at[5:]] = -0.97                                      # dead
        s.sound = np.ones((H, W), bool)
        s.sound.flat[at] = False


def dust(r):
    y, x = np.mgrid[0:H, 0:W]
    d = np.ones((H, W))
    for _ in range(12):
        d *= 1 - r.uniform(0.04, 0.12) * np.exp(-((x - r.uniform(0, W)) ** 2 + (y - r.uniform(0, H)) ** 2) / r.uniform(2, 5) ** 2 / 2)
    return d


def jpeg(f, q):
    """8x8 DCT, coarser quantisation at higher frequency (q DN at the lowest), back."""
    k = np.arange(8)
    C = np.sqrt(2 / 8) * np.cos(np.pi * (2 * k[None] + 1) * k[:, None] / 16)
    C[0] /= np.sqrt(2)
    b = f.reshape(H // 8, 8, W // 8, 8).transpose(0, 2, 1, 3).astype(float)
    step = q * (1 + (k[:, None] + k[None]) * 0.5)
    b = C.T @ (np.rint(C @ b @ C.T / step) * step) @ C
    return np.clip(np.rint(b.transpose(0, 2, 1, 3).reshape(H, W)), 0, TOP).astype(np.uint16)


def median3(f):
    p = np.pad(f, 1, mode="edge")
    return np.median([p[i:i + H, j:j + W] for i in range(3) for j in range(3)], axis=0).astype(f.dtype)


def binned(f, how):
    b = f.reshape(H // 2, 2, W // 2, 2).astype(float)
    if how == "sum":
        return np.clip(b.sum((1, 3)), 0, 65535).astype(np.uint16)
    b = np.rint(b.mean((1, 3))).astype(np.uint16)
    return b if how == "mean" else b.repeat(2, 0).repeat(2, 1)


def plan(layout, cam, r):
    """Sets as people take them: darks first, then flats with exposures or lights increasing."""
    full = (TOP - cam.black) / cam.K                                     # e- to the top code
    tmax = float(r.choice([0.04, 0.08, 0.16]))
    n = int(r.choice([4, 8, 8, 16]))
    S = lambda kind, t, light=1.0, n=n, conf=0: dict(kind=kind, t=t, t_say=t, light=light, light_say=light, conf=conf, n=n,
                                                     say=kind, gain=1.0, black=0.0, cam="a", post=[], mult=1.0)
    if layout in ("sweep", "sweep3"):
        ts = [round(tmax * f, 6) for f in (0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0)]
        sets = [S("dark", t) for t in (ts if layout == "sweep" else (ts[0], ts[4], ts[7]))] + [S("flat", t) for t in ts]
        rate = 0.8 * full / tmax
    elif layout == "light":
        t = tmax / 2
        ls = [0.03, 0.06, 0.12, 0.25, 0.4, 0.6, 0.8, 1.0]
        sets = [S("dark", t), S("dark", tmax)] + [S("flat", t, l) for l in ls]
        rate = 0.8 * full / t
    elif layout == "emva":
        ts = [round(tmax * k / 20, 6) for k in range(1, 22)]
        sets = [S("dark", t, n=2) for t in ts] + [S("dark", ts[9], n=16)] + [S("flat", t, n=2) for t in ts] + [S("flat", ts[9], n=16)]
        rate = 1.0 * full / tmax                                         # the last one saturates
    else:
        sets = [S("dark", tmax / 4), S("dark", tmax)]
        for c in range(3):
            sets += [S("flat", tmax / 4, conf=c), S("flat", tmax, conf=c)]
        rate = 0.75 * full / tmax
    return sets, rate, tmax


def spoil(kind, seed, layout, sets, cam, r, tmax):
    """Put the mistake in; return what it was."""
    darks = [s for s in sets if s["kind"] == "dark"]
    flats = [s for s in sets if s["kind"] == "flat"]
    late = flats[len(flats) // 2:] if layout != "calib" else flats[4:]
    pick = lambda *a: a[seed % len(a)]
    if kind == "dark-gain":
        g = pick(2.0, 4.0, 0.5, 2.0, 4.0, 0.5)
        for s in darks: s["gain"] = g
        return f"darks at gain x{g}"
    if kind == "dark-black":
        d = pick(-40, 12, 60, -12, 25, -5)
        for s in darks: s["black"] = d
        return f"darks at a black level {d:+} DN from that of the flats"
    if kind == "dark-other-camera":
        for s in darks: s["cam"] = "b"
        return "darks of another camera"
    if kind == "dark-long":
        f = pick(10, 30, 100, 50, 20, 100)
        keep = darks[-1]
        keep["t"] = keep["t_say"] = tmax * f; keep["n"] = max(keep["n"], 4)
        sets[:] = [s for s in sets if s["kind"] == "flat" or s is keep]
        return f"darks at one exposure only, {f} times the longest of the flats (stated truly)"
    if kind == "dark-swapped":
        a, b = (darks[0], darks[-1]) if layout != "emva" else (darks[1], darks[20])
        a["t_say"], b["t_say"] = b["t"], a["t"]
        return f"names of the darks at {a['t']} s and {b['t']} s exchanged"
    if kind == "dim-flats-as-dark":
        v = pick("one", "all", "one", "none", "all", "none")
        if v == "none":
            sets[:] = flats
            return "no darks at all"
        dim = flats[0]
        dim["say"] = "dark"
        gone = darks if v == "all" else [s for s in darks if s["t"] == dim["t"]][:1]
        sets[:] = [s for s in sets if not any(s is g for g in gone)]
        return f"the dimmest flats are labelled dark, in place of {'all' if v == 'all' else 'those'} darks{'' if v == 'all' else ' at that exposure'}"
    if kind == "subtracted":
        v = pick("black-flats", "dark-flats", "both", "dark-flats", "black-flats", "both")
        stored = np.rint(cam.K * (cam.dsnu + cam.dark * tmax) + cam.black)
        for s in flats + (darks if v == "both" else []):
            sub = round(cam.black) if v != "dark-flats" else stored
            s["post"].append(lambda f, sub=sub: np.clip(f.astype(int) - sub, 0, TOP).astype(np.uint16))
        return {"black-flats": "black level subtracted in the flats only", "dark-flats": "a stored dark frame subtracted in the flats only",
                "both": "black level subtracted in all frames, clipped at 0"}[v]
    if kind == "eight-bit":
        v = pick("file8", "value8", "padded8", "file8", "value8", "padded8")
        fn = {"file8": lambda f: (f >> 4).astype(np.uint8), "value8": lambda f: f >> 4, "padded8": lambda f: (f >> 4) << 4}[v]
        for s in late: s["post"].append(fn)
        return {"file8": "later flats saved as 8-bit files (code/16)", "value8": "later flats have code/16 in 16-bit files",
                "padded8": "later flats were 8 bit, shifted up again (code/16*16)"}[v]
    if kind == "turned":
        v = pick("180", "mirror", "row", "column", "180", "row")
        fn = {"180": lambda f: f[::-1, ::-1], "mirror": lambda f: f[:, ::-1], "row": lambda f: np.roll(f, 1, 0), "column": lambda f: np.roll(f, 1, 1)}[v]
        for s in late: s["post"].append(fn)
        return {"180": "later flats turned by 180 degrees", "mirror": "later flats mirrored"}.get(v, f"later flats shifted by one {v}")
    if kind == "digital-gain":
        b = pick(0.0, cam.black)
        for s in late: s["post"].append(lambda f, b=b: np.clip(np.rint((f - b) * 1.5 + b), 0, TOP).astype(np.uint16))
        return f"digital gain x1.5 in the later flats, {'about the black level' if b else 'black level included'}"
    if kind == "auto-exposure":
        for s in flats:
            s["t"] = 0.5 * tmax / s["light"] if layout != "light" else 0.25 * tmax / s["light"]
        return "auto exposure: every flat has the same level, whatever exposure is stated"
    if kind == "auto-gain":
        lim = 0.4
        for s in flats:
            x = s["light"] if layout == "light" else s["t"] / tmax
            if x > lim: s["gain"] = lim / x
        return "auto gain holds the level of the flats above 0.4 of the largest exposure or light"
    if kind == "stretch":
        for s in sets:
            s["post"].append(lambda f: np.rint((f.astype(float) - f.min()) / max(1, int(f.max()) - int(f.min())) * TOP).astype(np.uint16))
        return "contrast of each frame stretched from its minimum and maximum to 0..4095"
    if kind == "stamp":
        n = pick(8, 32, 16, 24)
        count = [0]
        def stamp(f):
            f = f.copy()
            count[0] += 1
            data = struct.pack(">IQ", count[0], 1700000000000000 + count[0] * 40123) + b"CAM1" * 8
            f[0, :n] = np.frombuffer(data[:n], np.uint8)
            return f
        for s in sets: s["post"].append(stamp)
        return f"first {n} pixels hold frame counter and time stamp"
    if kind == "dust":
        a, b = dust(r), dust(r)
        for s in flats: s["dust"] = a
        for s in late: s["dust"] = b
        return "dust moved before the later flats"
    if kind == "leak":
        y, x = np.mgrid[0:H, 0:W]
        leak = pick(0.01, 0.03, 0.05, 0.02) * np.exp(-x / W * 1.5)
        for s in darks: s["leak"] = leak / leak.mean() * leak.max()
        return f"light leak in darks, {leak.max():.3f} of the flats' light on average, stronger at the left"
    if kind == "warm-up":
        total = sum(s["n"] for s in flats); i = 0
        for s in flats:
            s["warm"] = []
            for _ in range(s["n"]):
                s["warm"].append(0.97 + 0.03 * (1 - np.exp(-2 * i / total)) / (1 - np.exp(-2))); i += 1
        return "lamp grew by 3 % while the flats were taken"
    if kind == "jpeg":
        q = pick(3, 6, 12, 24)
        for s in sets: s["post"].append(lambda f: jpeg(f, q))
        return f"lossy 8x8 DCT compression, step {q} DN at the lowest frequency"
    if kind == "unit-mix":
        return "half of the exposures in the names in ms, half in us, no unit"
    if kind == "exposure-step":
        step = 32e-6
        for s in sets:
            s["t_say"] = round(s["t_say"] * 1e-3 / tmax, 7)              # 20 us to 1 ms
            s["t"] = max(1, np.floor(s["t_say"] / step + 1e-9)) * step * tmax / 1e-3
        return "the camera rounds exposures down to multiples of 32 us"
    if kind == "binned":
        v = pick("mean", "sum", "replicated", "mean", "replicated", "sum")
        for s in late: s["post"].append(lambda f: binned(f, v))
        return f"later flats binned 2x2 ({v})"
    if kind == "denoised":
        v = pick("median", "average", "average", "median", "average", "median")
        for s in late:
            if v == "median": s["post"].append(median3)
            else: s["average"] = 4
        return "later flats filtered, " + ("3x3 median" if v == "median" else "each the mean of 4 frames")
    if kind == "dark-bits":
        bits = pick(2, 4, 2, 1, 2, 3)
        for s in darks: s["post"].append(lambda f: f >> bits)
        return f"darks of {12 - bits} bits beside flats of 12"
    if kind == "shading-corrected":
        gain = 1 / cam.shade
        for s in (flats if pick(0, 1) else sets):
            s["post"].append(lambda f: np.clip(np.rint((f - cam.black) * gain + cam.black), 0, TOP).astype(np.uint16))
        return "the camera corrects shading: frames above the black level times a smooth map"
    if kind == "subtracted-long":
        # Noise reduction of cameras: a dark of the same exposure, taken at once, is taken off, and the black level added again.
        limit = tmax * pick(0.3, 0.6)
        for s in sets:
            s["own_dark"] = s["t"] > limit
        return f"from {limit:g} s on a dark of the same exposure is taken off each frame"
    if kind == "nominal":
        for s in sets:
            s["t_say"] = s["t"]
            s["t"] = 2.0 ** (-np.round(-np.log2(s["t"]) * 3) / 3)
        return "exposures are nominal: the shutter works in thirds of a stop"
    if kind == "darks-smoothed":
        for s in darks: s["post"].append(median3)
        return "darks are smoothed, 3x3 median"
    if kind == "led":
        y, x = np.mgrid[0:H, 0:W]
        spot = np.exp(-((x - 0.8 * W) ** 2 + (y - 0.2 * H) ** 2) / 200.0)
        for s in darks: s["led"] = spot
        return "a LED of the camera blinks and lights a corner of every third dark"
    return "none"


def expose(s, i, cams, rate, r):
    cam = cams[s["cam"]]
    light = s["light"] * rate * s.get("warm", [1.0] * s["n"])[i] if s["kind"] == "flat" else 0.0
    field = cam.shade
    if s["conf"]:                                                        # card and lamp moved
        y, x = np.mgrid[0:H, 0:W]
        field = field * (1 + 0.04 * s["conf"] * ((x / W - 0.5) * (-1) ** s["conf"] + (y / H - 0.5)))
        field /= field.mean()
    e = light * s["t"] * field * s.get("dust", 1.0)
    if "leak" in s: e = s["leak"] * rate * s["t"]
    if "led" in s and i % 3 == 1: e = 0.02 * s["led"] * rate * s["t"]
    e = e * (1 + cam.prnu) + cam.dark * s["t"]
    q = r.poisson(e) + r.normal(0, cam.read) + cam.dsnu
    return np.clip(np.rint(q * cam.K * s["gain"] + cam.black + s["black"]), 0, TOP).astype(np.uint16)


def frame(s, i, cams, rate, r):
    if s.get("average"):
        f = np.rint(np.mean([expose(s, i, cams, rate, r) for _ in range(s["average"])], axis=0)).astype(np.uint16)
    else:
        f = expose(s, i, cams, rate, r)
    if s.get("own_dark"):
        own = expose(dict(s, kind="dark"), i, cams, rate, r)
        f = np.clip(f.astype(int) - own + round(cams["a"].black), 0, TOP).astype(np.uint16)
    for p in s["post"]: f = p(f)
    return np.ascontiguousarray(f)


def write(path, f, t=None, say=None):
    if path.endswith(".png"):
        d = f.astype(">u2" if f.dtype == np.uint16 else "u1")
        raw = b"".join(b"\0" + row.tobytes() for row in d)
        chunk = lambda n, b: struct.pack(">I", len(b)) + n + b + struct.pack(">I", zlib.crc32(n + b))
        head = struct.pack(">IIBBBBB", f.shape[1], f.shape[0], 8 * f.dtype.itemsize, 0, 0, 0, 0)
        open(path, "wb").write(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(raw, 1)) + chunk(b"IEND", b""))
    elif path.endswith(".fits"):
        b16 = f.dtype == np.uint16
        cards = ["SIMPLE  =                    T", f"BITPIX  = {16 if b16 else 8:20d}", "NAXIS   =                    2", f"NAXIS1  = {f.shape[1]:20d}",
                 f"NAXIS2  = {f.shape[0]:20d}"] + (["BZERO   =                32768", "BSCALE  =                    1"] if b16 else [])
        if t is not None: cards += [f"EXPTIME = {t:20.9f}", f"IMAGETYP= '{'DARK' if say == 'dark' else 'FLAT'}    '"]
        head = "".join(c.ljust(80) for c in cards + ["END"])
        data = (f.astype(int) - 32768).astype(">i2").tobytes() if b16 else f.tobytes()
        open(path, "wb").write(head.ljust(-(-len(head) // 2880) * 2880).encode() + data + b"\0" * (-len(data) % 2880))
    else:
        tifffile.imwrite(path, f)


def campaign(o):
    """Draws, asks `noise` and `diagnose`, prints a line for each and the counts."""
    table = {}
    for kind in [o.kind] if o.kind else KINDS:
        for seed in range(o.seed, o.seed + o.n):
            if kind == "unit-mix": continue                              # of names only
            d = os.path.join(o.out, f"{kind}-{seed}")
            subprocess.run([sys.executable, __file__, d, "--kind", kind, "--seed", str(seed), "--form", "dataset"], check=True)
            t = json.load(open(d + "/truth.json"))
            said = {}
            for verb in ("noise", "diagnose"):
                p = subprocess.run([o.radcam, verb, "--json", d + "/data"], capture_output=True, text=True)
                said[verb] = p.returncode, json.loads(p.stdout) if p.stdout.startswith("{") else {}
            code, n = said["noise"]
            faults, alarm = [f["text"] for f in n.get("data_faults", [])], code != 0
            def judge(q, true):
                v, e = (q or {}).get("value"), (q or {}).get("std_err") or 0
                if v is None: return "none"
                if abs(v - true) < max(3 * e, 0.02 * true): return "right"
                return "said" if alarm or faults else "WRONG"
            words = judge(n.get("gain_dn_per_e"), t["gain_dn_per_e"]), judge(n.get("read_noise_e"), t["read_noise_e"]["rms"])
            code, j = said["diagnose"]
            names = [m["effect"] for m in j.get("missing", [])]
            print(f"{kind:18} {seed:5} {t['layout']:7} gain {words[0]:6} read {words[1]:6} diagnose {code} {','.join(names)[:60]:40} {faults[0][:110] if faults else ''}", flush=True)
            row = table.setdefault(kind, dict.fromkeys(("n", "named", "gain WRONG", "read WRONG", "a name and no fault"), 0))
            row["n"] += 1
            row["named"] += bool(faults)
            row["gain WRONG"] += words[0] == "WRONG"
            row["read WRONG"] += words[1] == "WRONG"
            row["a name and no fault"] += bool(names) and not faults
            shutil.rmtree(d)
    print()
    for kind, row in table.items(): print(f"{kind:18}", ", ".join(f"{k} {v}" for k, v in row.items()))


def main():
    a = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    a.add_argument("out", nargs="?"); a.add_argument("--kind", choices=KINDS); a.add_argument("--seed", type=int, default=0)
    a.add_argument("--form", choices=("folder", "dataset")); a.add_argument("--layout", choices=sorted(set(LAYOUTS)))
    a.add_argument("--list", action="store_true")
    a.add_argument("--campaign", action="store_true"); a.add_argument("--radcam", default="radcam"); a.add_argument("--n", type=int, default=6)
    o = a.parse_args()
    if o.campaign: return campaign(o)
    if o.list or not o.out: print("\n".join(KINDS)); return
    ki = KINDS.index(o.kind)
    r = np.random.default_rng([20261127, ki, o.seed])
    cams = dict(a=Camera(r), b=Camera(r))
    cam = cams["a"]
    layout = o.layout or LAYOUTS[o.seed % 6]
    if o.kind == "exposure-step" and layout == "light": layout = "sweep"
    form = o.form or ("folder" if (o.seed + ki + o.seed // 6) % 2 == 0 or o.kind == "unit-mix" else "dataset")
    sets, rate, tmax = plan(layout, cam, r)
    what = spoil(o.kind, o.seed, layout, sets, cam, r, tmax)
    if o.kind == "exposure-step":                                        # the same light arrives in 1 ms; dark current is then small
        for s in sets: s["t"] *= 1e-3 / tmax
        rate *= tmax / 1e-3
    data = os.path.join(o.out, "data")
    os.makedirs(data, exist_ok=True)
    ext = ("tif", "png", "fits")[(o.seed + ki) % 3] if o.kind != "unit-mix" else "tif"
    style = (o.seed // 2) % 2                                            # 0 flat names, 1 a folder per set
    rows, clock, listed, used = [], 0.0, [], {}
    for n, s in enumerate(sets):
        us = s["t_say"] * 1e6
        name = f"{us / 1000:g}ms" if us >= 1000 else f"{us:g}us"
        if o.kind == "unit-mix":
            name = f"{us / 1000:g}" if n % 2 else f"{us:g}"
        stem = f"{s['say']}_{name}" + (f"_light{s['light_say']:g}" if layout == "light" and s["say"] == "flat" else "")
        if s["conf"] or layout == "calib" and s["say"] == "flat": stem += f"_config{s['conf']}"
        for i in range(s["n"]):
            f = frame(s, i, cams, rate, r)
            if form == "dataset":
                file = f"frames/{n:03d}_{i:02d}.{ext}"
            else:
                k = used[stem] = used.get(stem, -1) + 1
                file = f"{stem}_{k:03d}.{ext}" if style == 0 else f"{n:02d}_{stem}/img_{i:03d}.{ext}"
            os.makedirs(os.path.dirname(os.path.join(data, file)), exist_ok=True)
            write(os.path.join(data, file), f, s["t_say"] if form == "folder" and o.kind != "unit-mix" else None, s["say"])
            level = s["light_say"] if s["say"] == "flat" else 0
            if layout == "emva" and level: level = rate / 0.6
            rows.append(f"{file},{s['say']},{n},{i},{s['t_say']:.9g},{level:.9g},{s['conf']},,{clock:.4f}")
            clock += s["t_say"] + 0.05
        clock += 2
        listed.append({k: s[k] for k in ("kind", "say", "t", "t_say", "light", "gain", "black", "cam", "conf", "n")} | {"set": n, "post": len(s["post"]) + ("average" in s)})
    if form == "dataset":
        unit = 'illumination_unit = "photons/px/s"' if layout == "emva" else 'illumination_unit = "relative"'
        open(os.path.join(data, "dataset.toml"), "w").write(f'format = "radcam-dataset/1"\n[camera]\nvendor = "Example"\nmodel = "C12"\nserial = "{1000 + o.seed}"\n'
            f'width = {W}\nheight = {H}\nbit_depth = 12\npixel_format = "Mono12"\n[bench]\n{unit}\n')
        open(os.path.join(data, "frames.csv"), "w").write("file,kind,set,index,exposure_s,illumination,configuration,temperature_c,timestamp_s\n" + "\n".join(rows) + "\n")
    t = tmax if layout != "light" else tmax / 2
    if o.kind == "exposure-step": t = 1e-3
    test = dict(kind="flat", t=t, light=0.7, conf=0, n=1, gain=1.0, black=0.0, cam="a", post=[])
    write(os.path.join(o.out, "test.tif"), frame(test, 0, cams, rate, r))
    np.save(os.path.join(o.out, "test.npy"), np.stack([cam.K * rate * t * 0.7 * cam.shade, cam.prnu, cam.sound, cam.black + cam.K * cam.dsnu, cam.K * cam.dark]).astype(np.float32))
    ok = cam.sound
    json.dump(dict(kind=o.kind, seed=o.seed, layout=layout, form=form, mistake=what, gain_dn_per_e=cam.K, read_noise_e=dict(rms=float(np.sqrt((cam.read[ok] ** 2).mean())),
              median=float(np.median(cam.read))), black_dn=cam.black, dark_current_e_per_s=dict(mean=float(cam.dark.mean()), mean_sound=float(cam.dark[ok].mean()),
              median=float(np.median(cam.dark))), dsnu_e=float(cam.dsnu.std()), prnu=float(cam.prnu[ok].std()), shading=float(np.ptp(cam.shade)),
              prnu_with_shading=float(((1 + cam.prnu) * cam.shade).std()), qe=0.6 if layout == "emva" else None, test_exposure_s=t, sets=listed),
              open(os.path.join(o.out, "truth.json"), "w"), indent=1)


if __name__ == "__main__":
    main()
