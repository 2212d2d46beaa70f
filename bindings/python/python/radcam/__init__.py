"""Radiometric camera calibration and noise estimation for machine vision.

Frames and maps are numpy arrays of (rows, columns) in DN. Paths are dataset folders, EMVA 1288 descriptors, tables or files of statistics, as the
program `radcam` takes them. Results are dataclasses with the numbers of the program, bit for bit. Long work leaves the interpreter to other
threads, ends at Ctrl-C, and shows a bar where tqdm is there and `progress=True`. Warnings and what is done go to `logging`, under "radcam".

>>> import radcam
>>> radcam.simulate("cmos12", "campaign", plan="quick", region=(0, 0, 64, 64))  # doctest: +SKIP
>>> print(radcam.noise("campaign").gain_dn_per_e)  # doctest: +SKIP
>>> print(radcam.diagnose("campaign").verdict)  # doctest: +SKIP
"""

from __future__ import annotations

import json as _json
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike, fspath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radcam import _radcam
from radcam._radcam import (
    HAS_ARAVIS,
    CalibrateError,
    Calibration,
    Camera,
    CameraError,
    CaptureError,
    Corrector,
    CorrectError,
    DatasetError,
    EmvaError,
    Frames,
    ModelError,
    Moments,
    NoiseError,
    ObserveError,
    PlanError,
    RadcamError,
    Sensor,
    __version__,
)
from radcam.effects import Effect, Page, Parameter, load_effects, register, unregister
from radcam.results import (
    Comparison,
    Diagnosis,
    Evaluation,
    FrameStatistics,
    Missing,
    NoiseLevel,
    NoiseReport,
    Proposal,
    Quantity,
    Remainder,
    Residual,
    Rung,
)

__all__ = [
    "HAS_ARAVIS", "CalibrateError", "Calibration", "Camera", "CameraError", "CaptureError", "Comparison", "CorrectError", "Corrector", "Dataset",
    "DatasetError", "Diagnosis", "Effect", "EmvaError", "Evaluation", "Frames", "FrameStatistics", "Missing", "Model", "ModelError", "Moments",
    "NoiseError", "NoiseLevel", "NoiseReport", "ObserveError", "Page", "Parameter", "Plane", "PlanError", "Proposal", "Quantity", "RadcamError", "Remainder",
    "Residual", "Rung", "Sensor", "Set", "__version__", "calibrate", "cameras", "capture", "compare", "diagnose", "effects_known", "emva", "load_effects", "merge", "moments",
    "noise", "reduce", "register", "simulate", "statistics", "unregister",
]  # fmt: skip

Path = str | PathLike[str]
#: A frame, (rows, columns): codes, DN.
Codes = NDArray[np.uint16] | NDArray[np.uint8]
#: True: a bar of tqdm where that is there. A function: called with (done, of).
Progress = bool | Callable[[int, int], object]
#: Of a colour mosaic: row and column, 0 or 1, of the one pixel of every 2 x 2 cell that is measured; (0, 0) is R of RGGB.
Plane = tuple[int, int]


def _paths(paths: Path | Sequence[Path]) -> list[str]:
    return [fspath(p) for p in ([paths] if isinstance(paths, (str, PathLike)) else paths)]


def _name(path: Path | None) -> str | None:
    return None if path is None else fspath(path)


@contextmanager
def _told(progress: Progress, what: str) -> Iterator[Callable[[int, int], object] | None]:
    if progress is False:
        yield None
        return
    if progress is not True:
        yield progress
        return
    try:
        from tqdm.auto import tqdm
    except ImportError:
        yield None
        return
    with tqdm(desc=what) as bar:

        def tell(done: int, of: int) -> None:
            bar.total = of
            bar.update(done - bar.n)

        yield tell


def noise(paths: Path | Sequence[Path], *, plane: Plane | None = None, progress: Progress = False) -> NoiseReport:
    """Gain A (DN/e), constant noise (DN^2) and read noise (e) from the growth of variance with the mean.

    Section IV of Healey and Kondepudy 1994, eq. (36) to (42). Two flats at two levels and darks at two exposures are enough. `plane`: one colour of
    a mosaic, (row, column) in its 2 x 2 cell.

    Raises NoiseError where there is too little for a line, DatasetError where a frame cannot be read.
    """
    with _told(progress, "noise") as tell:
        return NoiseReport.of_text(_radcam.noise(_paths(paths), tell, plane))


def compare(
    paths: Path | Sequence[Path], model: Path | Model | None = None, *, plane: Plane | None = None, progress: Progress = False
) -> Comparison:
    """A model (a `Model`, a file or a sensor's name; None: the paper's) against a campaign, on frames that its fit did not use."""
    with _told(progress, "reading") as tell:
        return Comparison.of_text(_radcam.compare(_paths(paths), model, tell, plane))


def diagnose(
    paths: Path | Sequence[Path], model: Path | Model | None = None, *, plane: Plane | None = None, progress: Progress = False
) -> Diagnosis:
    """The physical effects that a campaign shows and the model lacks, each with its size, its evidence and how far the error falls."""
    with _told(progress, "reading") as tell:
        text, plan = _radcam.diagnose(_paths(paths), model, tell, plane)
    found = _json.loads(text)
    return Diagnosis.of(found).with_plan(plan)


def emva(path: Path, release: str = "4.0", *, plane: Plane | None = None, progress: Progress = False) -> Evaluation:
    """A camera by EMVA 1288, each quantity with a standard error.

    `release`: "4.0", "3.1", or "reference-tool" for the definitions of PyPI's emva1288 1.0.2.
    """
    with _told(progress, "reading") as tell:
        return Evaluation.of_text(_radcam.emva(fspath(path), release, tell, plane))


def calibrate(
    path: Path, output: Path, estimator: str = "joint", *, overwrite: bool = False, progress: Progress = False
) -> Calibration:
    """Makes a calibration file of a campaign: dark reference, fixed pattern K, defects (Section V).

    `estimator`: "joint" (each light a smooth surface), "paper" (each light the mean over a window), "smooth" (one configuration is enough, and K
    then contains the card) or "flat-field" (K contains the light of the flats: corrected frames are even where the flats are).
    """
    with _told(progress, "reading") as tell:
        _radcam.calibrate(fspath(path), fspath(output), estimator, overwrite, tell)
    return Calibration(fspath(output))


def capture(
    camera: Path,
    output: Path,
    plan: Path = "standard",
    *,
    region: tuple[int, int, int, int] | None = None,
    full_exposure_s: float | None = None,
    resume: bool = False,
    progress: Progress = False,
) -> dict[str, Any]:
    """Captures a plan with a camera into a new dataset folder.

    `plan`: "quick", "standard", "emva1288", a plan file, or the text of one. `region`: first column, first row, width, height. Without
    `full_exposure_s` the exposure that brings the card close to full scale is searched for. `resume`: goes on, by its own plan, with a capture that
    was ended.
    """
    with _told(progress, "capture") as tell:
        return dict(_json.loads(_radcam.capture(
                    fspath(camera), fspath(output), fspath(plan), region, full_exposure_s, None, None, resume, tell
                )))


def simulate(
    sensor: Path | Model,
    output: Path,
    plan: Path = "standard",
    *,
    region: tuple[int, int, int, int] | None = None,
    seed: int | None = None,
    progress: Progress = False,
) -> dict[str, Any]:
    """Captures a plan with a simulated camera: a sensor's name, a model file or a `Model`. `seed`: another specimen of it."""
    with _told(progress, "simulate") as tell:
        camera = "sim:" + ("model" if isinstance(sensor, Model) else fspath(sensor))
        made = _radcam.capture(camera, fspath(output), fspath(plan), region, None, sensor, seed, False, tell)
        return dict(_json.loads(made))


def reduce(
    parts: Path | Sequence[Path],
    output: Path,
    *,
    plan: Path | None = None,
    look: bool = False,
    plane: Plane | None = None,
    overwrite: bool = False,
    progress: Progress = False,
) -> tuple[int, int]:
    """Reduces a campaign, or parts of it, to a file of statistics that `noise`, `compare` and `diagnose` take: (frames, sets).

    However a campaign is split, the merged statistics are those of the whole, bit for bit. Parts that are reduced by themselves do not know which
    pixels the whole leaves out; their frames are read again when they are merged. Two rounds avoid that: `look=True` for each part, `merge(...,
    look=True)`, then `plan=` with what that gave.
    """
    with _told(progress, "reducing") as tell:
        return _radcam.reduce(_paths(parts), fspath(output), _name(plan), look, overwrite, tell, plane)


def merge(
    statistics: Sequence[Path],
    output: Path,
    *,
    look: bool = False,
    overwrite: bool = False,
    progress: Progress = False,
) -> tuple[int, int]:
    """Merges the statistics of parts of a campaign to those of the whole: (frames, sets)."""
    with _told(progress, "merging") as tell:
        return _radcam.reduce(_paths(statistics), fspath(output), None, look, overwrite, tell)


def statistics(frames: Iterable[Codes], bit_depth: int = 16) -> FrameStatistics:
    """The noise of frames of one level, (rows, columns) uint16 or uint8 each, from any iterable: variance, covariances, rows, columns.

    Memory does not grow with the number of frames. Raises ValueError with fewer than two.
    """
    text = _radcam.statistics(frames, bit_depth)
    if text is None:
        raise ValueError("statistics of the noise need two frames")
    return FrameStatistics.of_text(text)


def moments(frames: Iterable[Codes], bit_depth: int = 16) -> Moments:
    """Mean and variance of every pixel over frames from any iterable; the sums are whole numbers, so that parts merge exactly."""
    found: Moments | None = None
    for frame in frames:
        if found is None:
            if np.ndim(frame) != 2:
                raise TypeError(f"a frame is an array of (rows, columns), and this has {np.ndim(frame)} dimensions")
            rows, columns = frame.shape
            found = Moments((rows, columns), bit_depth)
        found.add(frame)
    if found is None:
        raise ValueError("there are no frames")
    return found


@dataclass(frozen=True)
class Listed:
    """A camera that can be opened now, by `Camera(name)`."""

    name: str
    vendor: str
    model: str
    serial: str
    protocol: str


def cameras() -> list[Listed]:
    """Cameras that answer, and the simulated ones. A search of networks and USB takes about a second."""
    return [Listed(*c) for c in _radcam.cameras()]


def effects_known() -> list[dict[str, Any]]:
    """The catalogue: of each effect what it does, how it shows, what to do about it, and its parameters; own ones last."""
    return list(_json.loads(_radcam.catalogue()))


@dataclass(frozen=True)
class Set:
    """Frames that share every setting, in the order of time."""

    number: int
    kind: str
    exposure_s: float
    illumination: float
    configuration: int
    #: Rows of the dataset.
    rows: list[int]


class Dataset:
    """A campaign on disk: a dataset folder, an EMVA 1288 descriptor or a file of statistics.

    Iterating over `frames(set)` reads one frame at a time, (rows, columns) uint16.
    """

    def __init__(self, path: Path):
        self._native = _radcam.Dataset(fspath(path))
        self.rows: list[dict[str, Any]] = _json.loads(self._native.rows())
        self.manifest: dict[str, Any] = _json.loads(self._native.manifest())
        sets: dict[int, Set] = {}
        for at, row in enumerate(self.rows):
            new = Set(row["set"], row["kind"], row["exposure_s"], row["illumination"], row["configuration"], [])
            sets.setdefault(row["set"], new).rows.append(at)
        for one in sets.values():
            one.rows.sort(key=lambda at: int(self.rows[at]["index"]))
        self.sets = list(sets.values())

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self._native.shape

    @property
    def bit_depth(self) -> int:
        """Bits of a code."""
        return self._native.bit_depth

    def read(self, row: int) -> NDArray[np.uint16]:
        """The frame of a row, (rows, columns), DN."""
        return self._native.read(row)

    def frames(self, of: Set) -> Iterator[NDArray[np.uint16]]:
        """The frames of a set, one at a time."""
        return (self.read(row) for row in of.rows)

    def to_frame(self) -> Any:
        """`frames.csv` as a pandas table."""
        import pandas

        return pandas.DataFrame(self.rows)


class Model:
    """A model of a camera: the paper's parameters and effects, as TOML."""

    def __init__(self, text: str):
        self._content: dict[str, Any] = _json.loads(_radcam.check_model(text))
        self.text = text

    @classmethod
    def load(cls, name: Path) -> Model:
        """A sensor's name or a model file."""
        return cls(_radcam.load_model(fspath(name)))

    def add(self, effect: str, **parameters: float) -> Model:
        """With one more effect; parameters that are not given are found by `fit`."""
        return Model(_radcam.add_to_model(self.text, effect, parameters))

    def remove(self, effect: str) -> Model:
        """Without an effect."""
        return Model(_radcam.remove_from_model(self.text, effect))

    def fit(self, paths: Path | Sequence[Path], *, plane: Plane | None = None, progress: Progress = False) -> Model:
        """With the values that a campaign shows."""
        with _told(progress, "reading") as tell:
            return Model(_radcam.fit_model(self.text, _paths(paths), tell, plane))

    def json(self) -> dict[str, Any]:
        """All of it."""
        return self._content

    @property
    def effects(self) -> list[str]:
        """Names of its effects."""
        return [e["id"] for e in self._content.get("effect", [])]

    def save(self, path: Path, *, overwrite: bool = False) -> None:
        """Writes it as TOML."""
        _radcam.may_be_written(path, overwrite)
        with open(path, "w", encoding="utf-8") as file:
            file.write(self.text)

    def __repr__(self) -> str:
        return f"Model({', '.join(self.effects) or 'no effects'})"
