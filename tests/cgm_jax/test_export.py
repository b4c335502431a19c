"""What export refuses; the models themselves: tests/cgm_jax/results/test_onnx_model.py."""

from importlib.machinery import ModuleSpec
from pathlib import Path

import pytest

from cgm_jax import export
from cgm_jax.config.fields import SettingError

BAD_INPUT = {
    "": "source: name a run directory or a policy file, or give --pretrained",
    "here --pretrained reach": "source: name a run directory or a policy file",
    "--pretrained reach": "onnx: say --onnx, the only format so far",
    "--pretrained slide --onnx": "pretrained: no policy 'slide'",
    "nowhere --onnx": "source: nowhere is no policy file, and holds none in policies/",
    "--pretrained reach --onnx --out nowhere": "out: nowhere is no directory",
    "README.md --onnx": "not a readable policy file: README.md",
}


@pytest.mark.parametrize("arguments", BAD_INPUT)
def test_bad_input_is_refused_in_one_line(arguments: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(export, "find_spec", lambda name: ModuleSpec(name, None))
    monkeypatch.chdir(Path(__file__).parents[2])
    with pytest.raises(SettingError) as refusal:
        export.main(arguments.split())
    assert str(refusal.value).startswith(BAD_INPUT[arguments])
    assert "\n" not in str(refusal.value)


def test_without_onnx_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(export, "find_spec", lambda _: None)
    with pytest.raises(SettingError, match=r"pip install '\.\[onnx\]'"):
        export.main(["--pretrained", "reach", "--onnx"])


@pytest.mark.parametrize("link", ["policies", "policies/a.npz"])
def test_nothing_is_written_where_a_directory_from_elsewhere_leads(
    link: str, tmp_path: Path
) -> None:
    source, elsewhere = tmp_path / "source", tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "a.npz").touch()
    (source / link).parent.mkdir(parents=True)
    (source / link).symlink_to(elsewhere / Path(link).relative_to("policies"))
    with pytest.raises(SettingError, match=f"{link} is a symbolic link, which a run directory may"):
        export.main([str(source), "--onnx"])
    assert [path.name for path in elsewhere.iterdir()] == ["a.npz"]
