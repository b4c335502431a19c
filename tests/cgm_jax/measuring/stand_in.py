"""A repository whose sweeps cost what they are told: stands for commits of known speed."""

import subprocess
from pathlib import Path

SWEEP = """
import argparse, json, os, pathlib, sys, time

parser = argparse.ArgumentParser()
parser.add_argument("--out", type=pathlib.Path)
parser.add_argument("--epochs", type=int, default=100)
parser.add_argument("--runs", type=int, default=1)
parser.add_argument("--groups", type=int, default=1)
parser.add_argument("--fail", type=int, default=0)
options = parser.parse_args()

def burn(seconds):
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass

assert pathlib.Path.cwd() == pathlib.Path(__file__).parents[1]
cache = pathlib.Path(os.environ["JAX_COMPILATION_CACHE_DIR"])
assert not cache.exists()
cache.mkdir()
if options.fail:
    print("error: told to fail", file=sys.stderr)
    sys.exit(options.fail)
burn({start})
options.out.mkdir()
(options.out / "pid").write_text(str(os.getpid()))
for group in range(options.groups):
    for epoch in range(1, options.epochs + 1):
        time.sleep(0.1)  # here it is paused, even if somewhat late
        burn({epoch})
        with (options.out / "metrics.jsonl").open("a") as file:
            for run in range(options.runs):
                row = {{"run": run, "epoch": epoch, "env_steps": 100 * epoch}}
                file.write(json.dumps(row) + "\\n")
"""


def write_checkout(root: Path, *, start: float, epoch: float) -> None:
    """Files of a commit whose sweeps take CPU seconds for their start and for each epoch."""
    for package in ("cgm_jax", "envs"):
        (root / package).mkdir(parents=True, exist_ok=True)
        (root / package / "__init__.py").touch()
    (root / "cgm_jax" / "sweep.py").write_text(SWEEP.format(start=start, epoch=epoch))


def git(root: Path, *arguments: str) -> str:
    """Run git as somebody with a name; what it prints."""
    identity = ("-c", "user.name=Tester", "-c", "user.email=tester@example.org")
    command = ["git", "-C", str(root), *identity, *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def commit(root: Path, message: str) -> str:
    """Commit all files, in a new repository if there is none yet; the commit's hash."""
    if not (root / ".git").exists():
        git(root, "init")
    git(root, "add", "--all")
    git(root, "commit", "--quiet", "--message", message)
    return git(root, "rev-parse", "HEAD").strip()
