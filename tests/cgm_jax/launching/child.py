"""Stands in for a sweep: child.py OUT STEP ... does what its n-th step says at its n-th start.

A step is EPOCHS:END. It writes checkpoints for so many more epochs; then END is an exit code, or
"kill" (as kill -9 does), or "wait": for SIGTERM, then with 75, having noted how often it came. What
it refuses, by 2, it says.
"""

import json
import os
import signal
import sys
import time
from pathlib import Path

out, steps = Path(sys.argv[1]), sys.argv[2:]
out.mkdir(parents=True, exist_ok=True)
starts = out / "starts"
number = len(starts.read_text().splitlines()) if starts.exists() else 0
blocked = signal.pthread_sigmask(signal.SIG_BLOCK, [])
with starts.open("a") as file:
    cores = sorted(os.sched_getaffinity(0))
    print(json.dumps({"cores": cores, "blocked": sorted(blocked), "ids": os.getpid()}), file=file)
terminations: list[int] = []
signal.signal(signal.SIGTERM, lambda *_: terminations.append(1))
(out / "checkpoints").mkdir(exist_ok=True)  # tests wait for it
epochs, end = steps[min(number, len(steps) - 1)].split(":")
done = len(list((out / "checkpoints").iterdir()))
for epoch in range(done + 1, done + int(epochs) + 1):
    (out / f"checkpoints/group0_epoch{epoch:06d}_cycle000000.json").touch()
if end == "kill":
    os.kill(os.getpid(), signal.SIGKILL)
if end == "wait":
    deadline = time.monotonic() + 60
    while not terminations and time.monotonic() < deadline:
        time.sleep(0.01)
    time.sleep(0.3)
    (out / "terminations").write_text(str(len(terminations)))
    end = "75"
if end == "2":
    print("working\nerror: kappa: is bad\x1b[2J", flush=True)
sys.exit(int(end))
