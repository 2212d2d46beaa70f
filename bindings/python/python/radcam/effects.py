"""Effects of one's own: a class that draws and predicts, known to all verbs once it is registered."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike, fspath

import numpy as np
from numpy.typing import NDArray

from radcam import _radcam
from radcam._radcam import Campaign, Drawn, PlainCamera, Prediction, SetPrediction

__all__ = ["Campaign", "Drawn", "Effect", "Page", "Parameter", "PlainCamera", "Prediction", "SetPrediction", "load_effects", "register", "unregister"]


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect, within `min` and `max`; a search begins at each of `starts`. `unit`: "1" for a ratio."""

    name: str
    meaning: str
    unit: str
    min: float
    max: float
    starts: Sequence[float]


@dataclass(frozen=True)
class Page:
    """What people want to know of an effect. `sets`: the measurement that separates it from its look-alikes, one of darks, sweep, pairs,
    transitions, reference, long, scenes."""

    what: str
    equation: str
    signature: str
    look_alikes: str
    remedy: str
    measure: str
    source: str
    sets: str = "sweep"


class Effect:
    """An effect. It does two things that check each other: it draws (changes a frame at its place in the chain) and it predicts (shifts the
    expected statistics of a campaign).

    Set `id`, `stage` (light, charge, well, transfer, read, amplifier, converter or firmware), `parameters` and `page`. Until the amplifier images
    and signals are in electrons, from it on in DN above the black level, at the firmware with the black level.
    """

    id: str
    stage: str
    parameters: Sequence[Parameter]
    page: Page

    def example(self, camera: PlainCamera) -> Sequence[float] | None:
        """Values at which it is plain to see with this camera; None where flats and darks show nothing of it."""
        return None

    def predict(self, p: Sequence[float], campaign: Campaign, out: Prediction) -> None:
        """Shifts what is expected: `out.sets` one by one, and `out.frame_signal`, which is assigned as a whole."""
        raise NotImplementedError

    def draw(self, p: Sequence[float], image: NDArray[np.float64], frame: Drawn) -> NDArray[np.float64] | None:
        """Changes the image in place, or returns another of its shape."""
        raise NotImplementedError

    def random(self, frame: Drawn) -> np.random.Generator:
        """Random numbers of this effect: the same for the same frame and seed."""
        return np.random.default_rng([frame.seed, frame.frame, zlib.crc32(self.id.encode())])


def register(effect: Effect) -> None:
    """Makes an effect known to `simulate`, `compare`, `diagnose` and models, in this process.

    Raises ValueError where one of that name is there already, or what it says of itself does not fit.
    """
    page = effect.page
    texts = (page.what, page.equation, page.signature, page.look_alikes, page.remedy, page.measure, page.source)
    parameters = [(p.name, p.meaning, p.unit, p.min, p.max, list(p.starts)) for p in effect.parameters]
    _radcam.register(effect, effect.id, effect.stage, parameters, texts, page.sets)


def unregister(effect: Effect | str) -> None:
    """Takes an effect of one's own out again, by itself or by its `id`. Raises ValueError where there is none."""
    _radcam.unregister(effect if isinstance(effect, str) else effect.id)


def load_effects(folder: str | PathLike[str]) -> list[str]:
    """Makes the effects of a folder's files (*.toml, as `radcam effects new` writes them) known, in this process; their names.

    Raises ValueError where a file is no effect, or another effect has its name.
    """
    return _radcam.load_effects(fspath(folder))
