"""An effect of the user's own draws and predicts, and is found."""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import radcam
from radcam.effects import Campaign, Drawn, Effect, Page, Parameter, PlainCamera, Prediction


class RowGain(Effect):
    """Each row's signal times 1 + rel N(0, 1), anew in every frame."""

    id = "row-gain-of-python"
    stage = "amplifier"
    parameters = (Parameter("rel", "standard deviation of a row's gain from frame to frame, relative", "1", 0.0, 0.1, (0.001,)),)
    page = Page(
        what="The reference of the column converters is sampled for each row, with noise of its own.",
        equation="v' = v (1 + rel N(0,1)), one number a row; variance of row means + (rel mu)^2",
        signature="variance of row means growing as the square of the mean",
        look_alikes="row noise is the same at every level",
        remedy="masked columns of known charge, divided out row by row",
        measure="flats at several levels",
        source="made for this test",
    )

    def example(self, camera: PlainCamera) -> Sequence[float]:
        return [0.15 / camera.range_e**0.5]

    def predict(self, p: Sequence[float], campaign: Campaign, out: Prediction) -> None:
        for of_set in out.sets:
            of_set.add_row((p[0] * of_set.signal) ** 2)

    def draw(self, p: Sequence[float], image: NDArray[np.float64], frame: Drawn) -> None:
        image *= 1 + p[0] * self.random(frame).standard_normal((image.shape[0], 1))


@pytest.fixture(scope="module", autouse=True)
def registered() -> None:
    radcam.register(RowGain())


REL = 0.003
SEEDS = range(20, 23)


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("own")
    model = radcam.Model.load("cmos12").add("row-gain-of-python", rel=REL)
    model.save(folder / "model.toml")
    for seed in SEEDS:
        radcam.simulate(folder / "model.toml", folder / f"campaign{seed}", region=(0, 0, 96, 64), seed=seed)
    return sorted(folder.glob("campaign*"))


def test_drawn_is_predicted(drawn: list[Path]) -> None:
    """Over three campaigns: residuals of the model with the effect have the size that their errors say; without it they do not."""
    model = drawn[0].parent / "model.toml"
    with_it = [radcam.compare(c, model) for c in drawn]
    # The smallest of three chances lies below 1e-3 in 3 of 1000 runs.
    assert min(c.p_value for c in with_it) > 1e-3, [c.p_value for c in with_it]
    row = [r.z for c in with_it for r in c.residuals if r.statistic == "variance of row means"]
    assert len(row) > 100
    # Root mean square of n standardised residuals: 1 within four times 1 / sqrt(2 n), as of normal ones; neighbours share a little.
    rms = float(np.sqrt(np.mean(np.square(row))))
    assert abs(rms - 1) < 4 / np.sqrt(2 * len(row)) + 0.1, (rms, len(row))
    assert all(not radcam.compare(c).consistent for c in drawn)


def test_it_is_found(drawn: list[Path]) -> None:
    found = radcam.diagnose(drawn[0])
    assert found.effects[0] == "row-gain-of-python", found.verdict
    rel = found.missing[0].parameters["rel"]
    assert abs(rel.value - REL) < 4 * rel.std_err, rel
    assert "row-gain-of-python" in [e["id"] for e in radcam.effects_known()]


def test_faults_of_an_effect_are_raised(drawn: list[Path], tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="already"):
        radcam.register(RowGain())
    wrong = RowGain()
    wrong.id, wrong.stage = "another-of-python", "nowhere"
    with pytest.raises(ValueError, match="nowhere"):
        radcam.register(wrong)
    # Known effects stay for the life of a process, and every search tries them: a process of its own.
    said = subprocess.run([sys.executable, "-c", BROKEN, drawn[0], tmp_path], capture_output=True, text=True)
    assert said.returncode == 0, said.stderr


BROKEN = """
import sys
import radcam

class Broken(radcam.Effect):
    id, stage = "broken-of-python", "amplifier"
    parameters = (radcam.Parameter("rel", "nothing", "1", 0.0, 0.1, (0.001,)),)
    page = radcam.Page("", "", "", "", "", "", "")

    def predict(self, p, campaign, out):
        raise RuntimeError("predict is broken")

    def draw(self, p, image, frame):
        raise RuntimeError("draw is broken")

campaign, folder = sys.argv[1:]
radcam.register(Broken())
radcam.Model.load("cmos12").add("broken-of-python", rel=0.01).save(f"{folder}/model.toml")
for verb, act in (
    ("draw", lambda: radcam.simulate(f"{folder}/model.toml", f"{folder}/c", "quick", region=(0, 0, 64, 64))),
    ("predict", lambda: radcam.compare(campaign, f"{folder}/model.toml")),
):
    try:
        act()
    except RuntimeError as e:
        assert str(e) == f"{verb} is broken"
    else:
        raise AssertionError(verb)
"""


class Unfinished(RowGain):
    id = "unfinished"

    def predict(self, p: Sequence[float], campaign: Campaign, out: Prediction) -> None:
        out.sets[0].signal = float("nan")


class Brighter(RowGain):
    """Moves the signal of sets, and of no frame."""

    id = "brighter-of-python"
    stage = "charge"

    def predict(self, p: Sequence[float], campaign: Campaign, out: Prediction) -> None:
        for of_set in out.sets:
            of_set.signal += p[0] * of_set.signal**2 / 1e4

    def draw(self, p: Sequence[float], image: NDArray[np.float64], frame: Drawn) -> None:
        image += p[0] * image**2 / 1e4


def test_what_an_effect_does_wrong_is_told_and_it_can_be_taken_out(drawn: list[Path]) -> None:
    with pytest.raises(TypeError, match="not the class"):
        radcam.register(Unfinished)  # type: ignore[arg-type]
    bare = Unfinished()
    bare.parameters = (Parameter("rel", "nothing", "1", 0.0, 0.1, ()),)
    with pytest.raises(ValueError, match="one start"):
        radcam.register(bare)
    radcam.register(Unfinished())
    model = radcam.Model.load("cmos12").add("unfinished", rel=0.01)
    with pytest.raises(ValueError, match="unfinished: predict left set 0"):
        radcam.compare(drawn[0], model)
    radcam.unregister("unfinished")
    with pytest.raises(ValueError, match="no effect"):
        radcam.unregister("unfinished")
    assert "unfinished" not in {e["id"] for e in radcam.effects_known()}


def test_a_signal_that_is_moved_moves_its_frames(drawn: list[Path]) -> None:
    radcam.register(Brighter())
    try:
        without = radcam.compare(drawn[0])
        with_it = radcam.compare(drawn[0], radcam.Model.load("cmos12").add("brighter-of-python", rel=0.05))
        mean = [r.z for r in without.residuals if r.statistic == "mean"]
        assert mean != [r.z for r in with_it.residuals if r.statistic == "mean"]
    finally:
        radcam.unregister("brighter-of-python")
