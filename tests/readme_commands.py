"""Every command and program of README.md and docs/, by an interpreter that has the package.

`python -m tests.readme_commands PYTHON` runs them, in order and with the smallest settings, in a
folder that has an `envs` and an `assets` of its own: `make test-wheel` does, from a wheel alone.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
TEXT = "\n".join(page.read_text() for page in PAGES)
PLACEHOLDER = re.compile(r"\b(DIR|COMMIT|FILE|NAME)\b")
LEFT_OUT = (
    *("cgm_jax.benchmark", "--on slurm", "--on ray", "stable_baselines3", "pandas", "npz"),
    "panda_gym",
)
"""The benchmark wants a machine to itself; SLURM, Ray and Stable-Baselines3 have targets of their
own; pandas and the policy that is evaluated in numpy have tests that do not need a wheel; panda-gym
is large."""


def commands() -> list[list[str]]:
    """Commands of the package, as words, with the smallest settings in place of theirs."""
    lines = re.findall(r"^ {4}(python -m cgm_jax\..*)$", TEXT, re.MULTILINE)
    return [
        _smallest(shlex.split(line, comments=True)[1:])
        for line in dict.fromkeys(lines)  # a page may repeat what another says
        if not PLACEHOLDER.search(line) and not any(word in line for word in LEFT_OUT)
    ]


def programs() -> list[str]:
    """Python programs that stand on their own."""
    blocks = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)
    left_out = (*LEFT_OUT, "--8<--")  # what a page takes from a file is tested there
    return [block for block in blocks if not any(word in block for word in left_out)]


def _smallest(words: list[str]) -> list[str]:
    for option, value in (("--preset", "smoke"), ("--epochs", "3")):
        if option in words:
            words[words.index(option) + 1] = value
    trains = words[1] in ("cgm_jax.train", "cgm_jax.sweep")
    if trains and not {"--preset", "--config", "--resume"} & {*words}:
        return [*words, "--preset", "smoke"]
    return words


def make_clashing(folder: Path) -> None:
    """Put files into a folder whose names are those of folders in this repository."""
    for name in ("envs", "assets"):
        (folder / name).mkdir()
        (folder / name / "__init__.py").write_text("raise ImportError('the wrong one')\n")
        (folder / f"{name}.py").write_text("raise ImportError('the wrong one')\n")


def main(python: str) -> int:
    """Run all; return 1 if one has failed."""
    failed = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_clashing(folder)
        (folder / "settings.toml").write_text('preset = "smoke"\n')
        shutil.copytree(ROOT / "tests/examples", folder / "tests/examples")
        variables = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
        variables["XDG_STATE_HOME"] = str(folder / "state")
        for words in [*commands(), *(["-c", program] for program in programs())]:
            began = time.monotonic()
            result = subprocess.run(
                [python, *words],
                cwd=folder,
                env=variables,
                capture_output=True,
                text=True,
                check=False,
            )
            verdict = "failed" if result.returncode else "passed"
            failed += result.returncode != 0
            shown = shlex.join(words).partition("\n")[0]
            print(f"{verdict} in {time.monotonic() - began:.0f} s: {shown}", flush=True)
            if result.returncode:
                print("".join(_last_lines(result.stdout + result.stderr)), flush=True)
    print(f"{len(commands()) + len(programs()) - failed} passed, {failed} failed")
    return min(failed, 1)


def _last_lines(text: str) -> Iterator[str]:
    yield from (f"    {line}\n" for line in text.splitlines()[-20:])


if __name__ == "__main__":
    sys.exit(main(str(Path(sys.argv[1]).absolute())))
