"""Statistics of parts are those of the whole."""

import csv
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

import radcam

Row = dict[str, str]


def split(campaign: Path, to: Path, part_of: Callable[[int, Row], int], parts: int) -> list[Path]:
    """Copies a campaign as parts, each a dataset with some of its rows."""
    with open(campaign / "frames.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    made = []
    for part in range(parts):
        folder = to / f"part{part}"
        (folder / "frames").mkdir(parents=True)
        shutil.copy(campaign / "dataset.toml", folder)
        own = [r for i, r in enumerate(rows) if part_of(i, r) == part]
        for row in own:
            shutil.copy(campaign / row["file"], folder / row["file"])
        with open(folder / "frames.csv", "w", newline="") as file:
            writer = csv.DictWriter(file, rows[0].keys(), lineterminator="\n")
            writer.writeheader()
            writer.writerows(own)
        made.append(folder)
    return made


def by_set(_: int, row: Row) -> int:
    return int(row["set"]) % 8


def by_frame(i: int, _: Row) -> int:
    return i % 8


@pytest.mark.parametrize("part_of", [by_set, by_frame])
def test_eight_parts_are_the_whole(lagging: Path, tmp_path: Path, part_of: Callable[[int, Row], int]) -> None:
    parts = split(lagging, tmp_path, part_of, 8)
    reduced = []
    for part in parts:
        reduced.append(tmp_path / f"{part.name}.stats")
        radcam.reduce(part, reduced[-1])
    frames, sets = radcam.merge(reduced, tmp_path / "all.stats")
    whole = radcam.Dataset(lagging)
    assert (frames, sets) == (len(whole.rows), len(whole.sets))
    # What is merged needs no frame any more.
    for part in parts:
        shutil.rmtree(part)
    for verb in (radcam.noise, radcam.diagnose, radcam.compare):
        assert verb(tmp_path / "all.stats").json() == verb(lagging).json()
    assert radcam.diagnose(tmp_path / "all.stats").effects == ["row-noise"]


def test_two_rounds_read_no_frame_twice(lagging: Path, tmp_path: Path) -> None:
    parts = split(lagging, tmp_path, by_set, 8)
    looks = []
    for part in parts:
        looks.append(tmp_path / f"{part.name}.look")
        radcam.reduce(part, looks[-1], look=True)
    radcam.merge(looks, tmp_path / "plan", look=True)
    reduced = []
    for part in parts:
        reduced.append(tmp_path / f"{part.name}.stats")
        radcam.reduce(part, reduced[-1], plan=tmp_path / "plan")
        shutil.rmtree(part)
    radcam.merge(reduced, tmp_path / "all.stats")
    assert radcam.diagnose(tmp_path / "all.stats").json() == radcam.diagnose(lagging).json()
    assert radcam.noise(tmp_path / "all.stats").json() == radcam.noise(lagging).json()


def test_what_does_not_go_together(lagging: Path, campaign: Path, tmp_path: Path) -> None:
    radcam.reduce(lagging, tmp_path / "a.stats")
    with pytest.raises(radcam.DatasetError, match="share no frame"):
        radcam.merge([tmp_path / "a.stats", tmp_path / "a.stats"], tmp_path / "b.stats")
    with pytest.raises(radcam.DatasetError, match="one camera"):
        radcam.reduce([lagging, campaign], tmp_path / "b.stats")
    assert not (tmp_path / "b.stats").exists()
    whole = (tmp_path / "a.stats").read_bytes()
    for at in (30, len(whole) // 2, len(whole) - 5):
        (tmp_path / "c.stats").write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
        with pytest.raises(radcam.DatasetError, match="damaged"):
            radcam.noise(tmp_path / "c.stats")
    (tmp_path / "c.stats").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(radcam.DatasetError, match="not whole"):
        radcam.noise(tmp_path / "c.stats")
