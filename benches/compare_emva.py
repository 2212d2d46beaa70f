"""`radcam emva` against the reference tool on the same files in one run: uncompressed TIFF and PNG, 640 x 480 and 2048 x 1536.

    target/venv-emva/bin/python benches/compare_emva.py target/release/radcam

Both are timed as their user meets them: reading and every quantity. The tool's time is without the start of Python and its imports
(radcam's with its start). Each pair of runs alternates; the median of three counts.
"""

import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time

HERE = os.path.dirname(os.path.abspath(__file__))
TOOL = os.path.join(HERE, "..", "tests", "outside", "emva.py")


def dataset(radcam, folder, width, height, stack):
    """A campaign of the standard's plan with a short stack, so that many runs fit."""
    model = open(os.path.join(HERE, "..", "sim", "src", "sensors", "imx252.toml")).read()
    model = model.replace("width = 2048", f"width = {width}").replace("height = 1536", f"height = {height}")
    model_file = os.path.join(folder, "model.toml")
    open(model_file, "w").write(model)
    sets = []
    for kind, light in (("dark", 0.0), ("flat", 1.0)):
        for i in range(1, 51):
            sets.append((kind, 2, 0.025 * i, light))
        sets.append((kind, stack, 0.6, light))
    plan = 'format = "radcam-plan/1"\nfull_exposure_s = 0.0128\n'
    for kind, frames, exposure, light in sets:
        plan += f'[[set]]\nkind = "{kind}"\nframes = {frames}\nexposure = {exposure}\nillumination = {light}\n'
    plan_file = os.path.join(folder, "plan.toml")
    open(plan_file, "w").write(plan)
    out = os.path.join(folder, "tiff")
    subprocess.run([radcam, "simulate", model_file, "--plan", plan_file, "-o", out], check=True, capture_output=True)
    return os.path.join(out, "EMVA1288_Data.txt"), 200 + 2 * stack


def as_png(descriptor, folder):
    from PIL import Image

    source = os.path.dirname(descriptor)
    os.makedirs(os.path.join(folder, "frames"))
    for name in os.listdir(os.path.join(source, "frames")):
        image = Image.open(os.path.join(source, "frames", name))
        image.save(os.path.join(folder, "frames", name.replace(".tiff", ".png")))
    text = open(descriptor).read().replace(".tiff", ".png")
    path = os.path.join(folder, "EMVA1288_Data.txt")
    open(path, "w").write(text)
    return path


def ours(radcam, descriptor):
    begin = time.perf_counter()
    subprocess.run([radcam, "emva", descriptor, "--as", "reference-tool", "--json"], check=True, capture_output=True)
    return time.perf_counter() - begin


def theirs(descriptor):
    out = subprocess.run([sys.executable, TOOL, "times", descriptor], check=True, capture_output=True, text=True)
    return json.loads(out.stdout)["all_s"]


def decoding(descriptor):
    """Seconds to decode the files with Pillow on one core: what the tool cannot be faster than."""
    from PIL import Image

    folder = os.path.join(os.path.dirname(descriptor), "frames")
    begin = time.perf_counter()
    for name in os.listdir(folder):
        Image.open(os.path.join(folder, name)).load()
    return time.perf_counter() - begin


def memory(radcam, descriptor):
    """Largest resident set, MB."""
    program = [radcam, "emva", descriptor, "--as", "reference-tool", "--json"]
    out = subprocess.run(["/usr/bin/env", "python3", "-c",
        "import resource,subprocess,sys; subprocess.run(sys.argv[1:],stdout=subprocess.DEVNULL,check=True);"
        "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss/1024)"] + program,
        check=True, capture_output=True, text=True)
    return float(out.stdout)


def main():
    radcam = os.path.abspath(sys.argv[1])
    print("| files | frames | ours s | ns/px | reference tool s | ratio | Pillow decoding s | ours MB |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for width, height, stack in ((640, 480, 50), (2048, 1536, 12)):
        folder = tempfile.mkdtemp()
        try:
            tiff, frames = dataset(radcam, folder, width, height, stack)
            png = as_png(tiff, os.path.join(folder, "png"))
            for kind, descriptor in (("TIFF", tiff), ("PNG", png)):
                ours(radcam, descriptor)
                pairs = [(ours(radcam, descriptor), theirs(descriptor)) for _ in range(3)]
                a, b = (statistics.median(p[k] for p in pairs) for k in (0, 1))
                pixel = a / (frames * width * height) * 1e9
                print(f"| {kind} {width} x {height} | {frames} | {a:.3f} | {pixel:.2f} | {b:.2f} | {b / a:.1f} "
                      f"| {decoding(descriptor):.2f} | {memory(radcam, descriptor):.0f} |", flush=True)
        finally:
            shutil.rmtree(folder)


if __name__ == "__main__":
    main()
