"""`python -m cgm_jax.export DIR --onnx`: trained policies in a form that other programs load.

DIR may also be one policy file, and `--pretrained TASK` chooses one that comes with the package.
Needs the extra: `pip install '.[onnx]'`. Nothing of a run directory is run, so that one from
elsewhere serves as well.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import tyro

from cgm_jax.config.fields import SettingError
from cgm_jax.host.command_line import parse, run_program
from cgm_jax.pretrained import NAMES as PRETRAINED
from cgm_jax.pretrained import pretrained_policy
from cgm_jax.storage.looking import is_directory, is_ordinary_file
from cgm_jax.storage.untrusted import printable

ONNX = ".onnx"


@dataclass(kw_only=True)
class ExportOptions:
    """Write policies as ONNX models: observation and goal to action, normalisation included."""

    source: Annotated[Path | None, tyro.conf.Positional] = None
    """Directory that a sweep or a training run has written, or one policy file (.npz)."""

    pretrained: Annotated[
        str | None, tyro.conf.arg(metavar=f"{{{','.join(PRETRAINED)}}}", help_behavior_hint="")
    ] = None
    """Export the policy of this task that comes with the package."""

    onnx: bool = False
    """Write NAME.onnx for each policy: the only format, so far."""

    out: Path | None = None
    """Directory for the models (default: beside the policies; for --pretrained the present one)."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program on command-line arguments; return its exit code.

    Raises:
        SettingError: input is refused.
        SystemExit: an argument is no option, or asks for help.
    """
    options = parse(ExportOptions, arguments, "python -m cgm_jax.export")
    files = _files(options)
    if not options.onnx:
        raise SettingError("onnx: say --onnx, the only format so far")
    if find_spec("onnx") is None:
        raise SettingError("onnx: the package onnx is missing; pip install '.[onnx]'")
    out = options.out
    if out is not None and not is_directory("out", out):
        raise SettingError(f"out: {out} is no directory")
    from cgm_jax.results.onnx_model import onnx_model
    from cgm_jax.storage.files import remove_abandoned, replacing
    from cgm_jax.storage.policies import load_policy

    try:
        policies = {path: load_policy(path) for path in files}
    except ValueError as error:
        raise SettingError(str(error)) from None
    for path, arrays in policies.items():
        beside = Path() if options.pretrained is not None else path.parent
        target = (out or beside) / f"{path.stem}{ONNX}"
        try:
            model = onnx_model(arrays).SerializeToString()
            remove_abandoned(target)
            with replacing(target) as file:
                file.write(model)
        except OSError as error:
            raise SettingError(f"out: cannot write {target}: {error.strerror}") from None
        print(printable(str(target)))
    return 0


def _files(options: ExportOptions) -> list[Path]:
    """The policy files to export.

    Raises:
        SettingError: none are chosen, there are none, or the run directory holds a link.
    """
    if (options.source is None) == (options.pretrained is None):
        raise SettingError("source: name a run directory or a policy file, or give --pretrained")
    if options.pretrained is not None:
        return [pretrained_policy(options.pretrained)]
    source = options.source
    assert source is not None
    if is_ordinary_file("source", source):
        return [source]
    from cgm_jax.storage.layout import check_parts

    check_parts(source)
    files = sorted(source.glob("policies/*.npz"))
    if not files:
        raise SettingError(f"source: {source} is no policy file, and holds none in policies/")
    return files


if __name__ == "__main__":
    run_program(main)
