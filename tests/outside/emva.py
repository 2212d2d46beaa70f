"""The EMVA 1288 reference tool (PyPI emva1288 1.0.2): its camera draws datasets, and its evaluation is printed as JSON.

    emva.py draw FOLDER SEED     a dataset of a random camera of the tool's own; prints the descriptor and what it was drawn with
    emva.py results DESCRIPTOR   every quantity that the tool prints, and its histograms
    emva.py times DESCRIPTOR...  seconds of each evaluation, reading and all quantities, without the start of Python
"""

import json
import math
import os
import sys
import time
import warnings

warnings.simplefilter("ignore")

import numpy as np  # noqa: E402


def number(value):
    value = float(value)
    return value if math.isfinite(value) else None


def evaluate(descriptor, pixel_area=None):
    from emva1288.process.data import Data1288
    from emva1288.process.loader import LoadImageData
    from emva1288.process.parser import ParseEmvaDescriptorFile
    from emva1288.process.results import Results1288

    parser = ParseEmvaDescriptorFile(descriptor, loglevel=50)
    data = Data1288(LoadImageData(parser.images, loglevel=50).data, loglevel=50)
    return Results1288(data.data, pixel_area=pixel_area, loglevel=50)


def results(descriptor, pixel_area):
    found = evaluate(descriptor, pixel_area)
    out = {}
    for name, info in found.results.items():
        value = info.get("value")
        if value is None:
            out[name] = None
        elif np.isscalar(value):
            out[name] = number(value)
        elif isinstance(value, dict):
            out[name] = {k: [number(v) for v in np.ravel(value[k])] for k in ("bins", "values") if k in value}
        elif "data" in info:
            out[name] = None
    for name in ("histogram_PRNU", "histogram_PRNU_accumulated", "histogram_DSNU", "histogram_DSNU_accumulated"):
        h = getattr(found, name)
        out[name] = {k: [number(v) for v in h[k]] for k in ("bins", "values")}
    return out


def draw(folder, seed):
    """A random camera: 8 to 16 bits, exposure or light varied, TIFF or PNG, with nonuniformities."""
    from emva1288.camera.dataset_generator import DatasetGenerator
    from emva1288.camera.routines import Qe

    rng = np.random.default_rng(seed)
    bits = [8, 10, 12, 14, 16][seed % 5]
    width, height = int(rng.integers(40, 90)), int(rng.integers(40, 90))
    full = 2**bits - 1
    electrons = rng.uniform(8e3, 40e3)
    truth = {
        "bit_depth": bits,
        "width": width,
        "height": height,
        "K": full / electrons,
        "blackoffset": full / 40,
        "sigma2_dark_0": rng.uniform(4, 200),
        "dark_signal_0": 0.0,
        "dark_current_ref": rng.uniform(10, 3000),
        "u_esat": 2 * electrons,
        "exposure_min": 1e6,
        "exposure_max": 5e8,
    }
    # Pillow writes no TIFF of 16 bits from what the tool hands it; its PNG it does.
    fixed = 2e7 if seed % 2 else None
    generator = DatasetGenerator(
        steps=int(rng.integers(14, 30)),
        L=int(rng.integers(6, 14)),
        outdir=folder,
        image_format="png",
        exposure_fixed=fixed,
        K_min=truth["K"],
        K_max=truth["K"],
        K_steps=1,
        blackoffset_min=truth["blackoffset"],
        blackoffset_max=truth["blackoffset"],
        blackoffset_steps=1,
        qe=Qe(width=width, height=height, wavelength=np.linspace(500, 560, 3)),
        dsnu=rng.normal(0, rng.uniform(0.5, 8), (height, width)),
        prnu=rng.normal(1, rng.uniform(0.002, 0.02), (height, width)),
        seed=seed,
        **truth,
    )
    return {"descriptor": generator.descriptor_path, "truth": truth}


def main():
    verb, first = sys.argv[1:3]
    if verb == "draw":
        print(json.dumps(draw(first, int(sys.argv[3]))))
    elif verb == "results":
        area = float(sys.argv[3]) if len(sys.argv) > 3 else None
        print(json.dumps(results(first, area)))
    elif verb == "times":
        for descriptor in sys.argv[2:]:
            begin = time.perf_counter()
            found = evaluate(descriptor)
            read = time.perf_counter() - begin
            found.results
            print(json.dumps({"descriptor": descriptor, "read_s": read, "all_s": time.perf_counter() - begin}))
    else:
        sys.exit(f"no verb {verb}; {__doc__}")


if __name__ == "__main__":
    sys.path = [p for p in sys.path if p != os.path.dirname(os.path.abspath(__file__))]
    main()
