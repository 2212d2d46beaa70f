"""Campaigns that several tests use, and a served camera."""

import json
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

import radcam

#: Small enough for a test, large enough for the statistics.
REGION = (0, 0, 96, 64)


@pytest.fixture(scope="session")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated camera that the paper's model describes."""
    path = tmp_path_factory.mktemp("clean") / "campaign"
    radcam.simulate("cmos12", path, "quick", region=REGION, seed=11)
    return path


@pytest.fixture(scope="session")
def lagging(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One with row noise."""
    folder = tmp_path_factory.mktemp("row")
    radcam.Model.load("cmos12").add("row-noise", e=4.0).save(folder / "row.toml")
    radcam.simulate(folder / "row.toml", folder / "campaign", region=REGION, seed=13)
    return folder / "campaign"


@pytest.fixture
def served() -> Iterator[str]:
    """A simulated camera, served over GigE Vision by the program that comes with the package."""
    program = shutil.which("radcam")
    assert program is not None
    arguments = [program, "serve", "cmos12", "--serial", "PY1", "--while-stdin", "--json", "--interface", "127.0.0.1"]
    with subprocess.Popen(arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None and child.stdin is not None
        json.loads(child.stdout.readline())
        yield "aravis:127.0.0.1"
        child.stdin.close()
        child.wait(20)
