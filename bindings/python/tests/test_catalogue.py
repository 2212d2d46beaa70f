"""Effects of formulas in files join the catalogue. Before effects in Python are known to this process, which every search would try."""

from pathlib import Path

import pytest

import radcam


def test_what_has_no_name_has_a_law_and_then_a_name(tmp_path: Path) -> None:
    """A law of a model file is proposed; the same formula in a file of a folder is known by name."""
    law = {"formulas": 'variance = "k * (mu / 1000)^2"', "parameters": "k = 9.0"}
    entry = "".join(f"[effect.{key}]\n{value}\n" for key, value in law.items())
    sensor = radcam.Model.load("cmos12").text.replace("width = 1024", "width = 96").replace("height = 768", "height = 64")
    model = sensor + '\n[[effect]]\nid = "custom"\nname = "jitter"\n' + entry
    (tmp_path / "model.toml").write_text(model)
    radcam.simulate(tmp_path / "model.toml", tmp_path / "campaign", seed=31)
    found = radcam.diagnose(tmp_path / "campaign")
    assert found.effects[0] == "unknown", found.verdict
    assert found.proposal is not None
    assert found.proposal.formulas == {"variance": "k * (mu / 1000)^2"}
    assert abs(found.proposal.parameters["k"].value - 9) < 4 * found.proposal.parameters["k"].std_err
    own = tmp_path / "own"
    own.mkdir()
    (own / "jitter.toml").write_text('name = "jitter-in-a-file"\n' + entry.replace("[effect.", "["))
    assert radcam.load_effects(own) == ["jitter-in-a-file"]
    try:
        named = radcam.diagnose(tmp_path / "campaign")
        assert (named.effects, named.proposal) == (["jitter-in-a-file"], None), named.verdict
        (own / "jitter.toml").write_text("name = 1")
        with pytest.raises(ValueError, match="jitter.toml"):
            radcam.load_effects(own)
    finally:
        radcam.unregister("jitter-in-a-file")
