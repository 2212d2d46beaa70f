"""Makes the files of tests/corpus/hdf5, with h5py 3.16 and numpy: python3 tests/corpus/hdf5.py"""

import os

import h5py
import numpy as np

HERE = os.path.join(os.path.dirname(os.path.abspath(__file__)), "hdf5")
GAIN, READ_NOISE_E, BLACK_DN = 0.5, 4.0, 40.0
random = np.random.default_rng(1994)


def frames(count, rows, columns, charge_e):
    """Frames of a 12-bit camera."""
    charge = random.poisson(charge_e, (count, rows, columns)) + random.normal(0, READ_NOISE_E, (count, rows, columns))
    return np.clip(np.round(GAIN * charge + BLACK_DN), 0, 4095).astype("u2")


def nxtomo(path):
    """NXtomo as beamlines write it: darks, flats at four exposures, projections, an invalid frame; time of each frame."""
    kinds, times, parts = [], [], []
    for kind, ms, count, charge in [
        (2, 1.0, 6, 0), (1, 5.0, 6, 700), (0, 5.0, 3, 300), (1, 10.0, 6, 1400), (1, 20.0, 6, 2800), (3, 20.0, 1, 9),
        (1, 40.0, 6, 5600), (2, 40.0, 6, 0),
    ]:
        parts.append(frames(count, 32, 40, charge))
        kinds += [kind] * count
        times += [ms] * count
    data = np.concatenate(parts)
    with h5py.File(path, "w", libver="earliest") as file:
        entry = file.create_group("entry")
        entry.attrs["NX_class"] = "NXentry"
        entry["definition"] = "NXtomo"
        detector = entry.create_group("instrument/detector")
        detector.attrs["NX_class"] = "NXdetector"
        detector.create_dataset("data", data=data, chunks=(1, 32, 40), compression="gzip", shuffle=True)
        detector["image_key"] = np.array(kinds, "i4")
        detector["count_time"] = np.array(times)
        detector["count_time"].attrs["units"] = "ms"
        detector["serial_number"] = "T-17"
        sample = entry.create_group("sample")
        sample["rotation_angle"] = np.zeros(len(kinds))
        sample["temperature"] = 290.0
        shown = entry.create_group("data")
        shown.attrs["NX_class"] = "NXdata"
        shown.attrs["signal"] = "data"
        shown["data"] = h5py.SoftLink("/entry/instrument/detector/data")
        shown["image_key"] = h5py.SoftLink("/entry/instrument/detector/image_key")


def exchange(path):
    """DataExchange of the Advanced Photon Source."""
    with h5py.File(path, "w") as file:
        file["implements"] = "exchange:measurement"
        for name, count, charge in [("data", 4, 300), ("data_white", 3, 1400), ("data_dark", 3, 0)]:
            file.create_dataset(f"exchange/{name}", data=frames(count, 12, 16, charge))
        file["exchange/theta"] = np.linspace(0, 180, 4)
        file["measurement/instrument/detector/exposure_time"] = np.array([0.02])
        file["measurement/instrument/detector/exposure_time"].attrs["units"] = "s"


def plain(path):
    """One dataset of single precision, packed with LZF in chunks of several frames, described by attributes."""
    with h5py.File(path, "w", libver="latest") as file:
        data = frames(5, 12, 16, 1400).astype("f4")
        stack = file.create_dataset("flats", data=data, chunks=(3, 12, 16), compression="lzf", shuffle=True)
        stack.attrs["exposure_time"] = 20.0
        stack.attrs["exposure_time_unit"] = "ms"


def two(path):
    """Two datasets that may be frames, one of them big-endian, the other of 8 bits."""
    with h5py.File(path, "w") as file:
        flats = frames(3, 12, 16, 1400)
        file.create_dataset("scan/camera_1", data=flats.astype(">u2"), fletcher32=True, chunks=(1, 6, 16))
        file.create_dataset("scan/camera_2", data=(flats // 16).astype("u1"))
        file["scan"].attrs["exposure_ms"] = 20.0


def single(path):
    """One frame, with its exposure."""
    with h5py.File(path, "w") as file:
        file["entry/instrument/camera/image"] = frames(1, 12, 16, 1400)[0]
        file["entry/instrument/camera/ExposureTime"] = 20.0
        file["entry/instrument/camera/ExposureTime"].attrs["units"] = "ms"


def broken_off(path):
    """A scan that was broken off: four frames of eight were written."""
    with h5py.File(path, "w") as file:
        stack = file.create_dataset("dark_20ms", (8, 12, 16), "u2", chunks=(1, 12, 16), compression="gzip")
        stack[:4] = frames(4, 12, 16, 0)


def elsewhere(path):
    """Frames in another file: a virtual dataset, as detectors of several modules have them."""
    with h5py.File(path, "w", libver="latest") as file:
        layout = h5py.VirtualLayout(shape=(3, 12, 16), dtype="u2")
        layout[:] = h5py.VirtualSource("modules.h5", "data", shape=(3, 12, 16))
        file.create_virtual_dataset("entry/data", layout)


def claims(path):
    """A dataset without chunks that claims a tebibyte."""
    with h5py.File(path, "w") as file:
        file.create_dataset("data", (1 << 13, 1 << 13, 1 << 14), "u2", chunks=(1, 64, 64))


def levels(path):
    """Frames in two axes, levels by repeats, with one exposure for each level."""
    with h5py.File(path, "w", libver="latest") as file:
        for name, light in [("dark", 0), ("flat", 1400)]:
            data = frames(6, 12, 16, light).reshape(2, 3, 12, 16)
            stack = file.create_dataset(name, data=data, chunks=(1, 3, 12, 16), compression="gzip")
            stack.attrs["exposure_ms"] = [5, 20]


def last_axis(path):
    """Frames along the last axis, as MATLAB writes them: rows, columns, frames. Pixels differ in charge."""
    with h5py.File(path, "w") as file:
        charge = 1400 + random.normal(0, 200, (24, 32))
        file.create_dataset("flat_20ms", data=np.moveaxis(frames(8, 24, 32, charge), 0, -1), compression="gzip")


for make in [nxtomo, exchange, plain, two, single, broken_off, elsewhere, claims, levels, last_axis]:
    end = "nxs" if make is nxtomo else "h5"
    make(os.path.join(HERE, f"{make.__name__}.{end}"))
