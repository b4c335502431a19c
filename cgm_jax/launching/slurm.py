"""Engine: a SLURM job array, by submitit; needs the extra `slurm`.

A job makes one attempt. Seventy seconds ahead of its time limit, or when it is preempted, SLURM
signals it and submitit requeues it; a node that fails requeues it as well; and neither needs the
launcher, which submits anew what else was ended from outside. Its jobs outlive it: started again
with --resume it takes them up.

submitit is used to submit and requeue. Whether a job is alive `squeue` tells, which also works
where SLURM keeps no accounts, and how it ended the part's own record (record.py).
"""

import importlib.util
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cgm_jax.config.fields import SettingError
from cgm_jax.host.exit_codes import ExitCode
from cgm_jax.launching.attempts import (
    ELSEWHERE,
    MAX_FRUITLESS,
    Attempt,
    Order,
    Step,
    next_step,
)
from cgm_jax.launching.directory import Launch, Resources, carried_environment
from cgm_jax.launching.record import append_event, events, fruitless_attempts, last_code
from cgm_jax.launching.supervision import Ended
from cgm_jax.storage.layout import SLURM

MARGIN_SECONDS = 70
"""From the signal to the time limit: SLURM may be a minute late."""

MIN_MINUTES = 3
SQUEUE_SECONDS = 5.0
GONE = ("CANCELLED", "COMPLETED", "FAILED", "TIMEOUT", "NODE_FAIL", "PREEMPTED", "OUT_OF_MEMORY")
GONE += ("BOOT_FAIL", "DEADLINE", "REVOKED")
ENDLESS = 10**6
"""Requeues that submitit allows; when to stop is told by attempts without progress."""

NEVER = (
    r"invalid (partition|account|qos|feature|generic)|reservation is invalid|unrecognized option"
)
"""In what sbatch says of jobs that no waiting helps."""

SBATCH = ("partition", "account", "qos", "constraint", "exclude", "nodelist", "reservation")
SBATCH += ("gres", "licenses", "nice", "exclusive", "comment")
"""Options of sbatch that a launch may have; others go into variables, such as SBATCH_CLUSTERS."""


class PartJob:
    """What a job runs; pickled by submitit."""

    def __init__(self, order: Order) -> None:
        self.order = order
        self._attempt: Attempt | None = None

    def __call__(self) -> int:
        """Make an attempt, unless too many have come no further; return its exit code."""
        import submitit

        record, out = Path(self.order.record), Path(self.order.out)
        if fruitless_attempts(record, out) >= MAX_FRUITLESS:
            return last_code(record) or ExitCode.FAILED
        self._attempt = Attempt(self.order, submitit.JobEnvironment().job_id)
        return self._attempt.run()

    def checkpoint(self) -> Any:
        """Called by submitit, in a signal handler, before it requeues the job."""
        from submitit.helpers import DelayedSubmission

        if self._attempt is not None:
            self._attempt.stop()
            self._attempt.finish()
        return DelayedSubmission(PartJob(self.order))


class Slurm:
    """A job array; see `supervision.Engine`."""

    _launch: Launch
    _executor: Any

    def __init__(self, resources: Resources) -> None:
        """Prepare to submit.

        Raises:
            SettingError: submitit or SLURM is missing, or a resource cannot be asked for.
        """
        if importlib.util.find_spec("submitit") is None:
            raise SettingError(
                "on: slurm needs submitit, which the extra installs: pip install '.[slurm]'"
            )
        for program in ("sbatch", "srun", "squeue", "scontrol"):
            if shutil.which(program) is None:
                raise SettingError(f"on: there is no SLURM here: {program} is not found")
        if resources.minutes < MIN_MINUTES:
            raise SettingError(f"minutes: {resources.minutes} is not at least {MIN_MINUTES}")
        self._resources, self._cores = resources, resources.cores or 1
        self._sbatch = sbatch_options(resources.sbatch)
        self._jobs: dict[int, str] = {}
        self._missed: dict[int, int] = {}
        self._asked, self._accepted = 0.0, False

    def check(self) -> None:
        """See `Engine`: ask for a job with these resources, which SLURM is not to run.

        What can never be is refused. Of other reasons, such as nodes that are down just now, SLURM
        might let the job wait for their end, and they are only said.
        """
        job_states()
        given = {
            "time": self._resources.minutes,
            "cpus-per-task": self._cores,
            "gpus-per-node": self._resources.gpus or None,
            "mem": _megabytes(self._resources),
            **{name.replace("_", "-"): value for name, value in self._sbatch.items()},
        }
        options = [
            f"--{name}" if value is True else f"--{name}={value}"
            for name, value in given.items()
            if value is not None
        ]
        try:
            _answer(["sbatch", "--test-only", *options, "--wrap=true"])
        except _NoAnswerError as error:
            if re.search(NEVER, str(error), re.IGNORECASE):
                raise SettingError(f"on: SLURM refuses the jobs: {error}") from None
            print(f"on: SLURM may not run the jobs: {error}", file=sys.stderr)

    def variables_here(self) -> None:
        """See `Engine`."""

    def begin(self, launch: Launch) -> None:
        """See `Engine`."""
        import submitit

        self._launch, resources = launch, self._resources
        executor = submitit.SlurmExecutor(_new_folder(launch.path), max_num_timeout=ENDLESS)
        optional = {"gpus_per_node": resources.gpus, "mem": _megabytes(resources)}
        executor.update_parameters(
            job_name=f"cgm_jax-{launch.path.name}"[:60],
            time=resources.minutes,
            cpus_per_task=self._cores,
            signal_delay_s=MARGIN_SECONDS,
            array_parallelism=launch.parts,
            stderr_to_stdout=True,
            # Steps do not inherit it since SLURM 22.05.
            srun_args=[f"--cpus-per-task={self._cores}"],
            setup=[_entering(Path.cwd())],
            additional_parameters={"requeue": True, **self._sbatch},
            **{name: value for name, value in optional.items() if value},
        )
        self._executor = executor

    @property
    def detached(self) -> str:
        """See `Engine`."""
        jobs = " ".join(sorted({job.partition("_")[0] for job in self._jobs.values()}))
        return f"the jobs go on in SLURM; to end them: scancel {jobs}" if jobs else ""

    def room(self) -> int:
        """See `Engine`."""
        return self._launch.parts

    def start(self, parts: Sequence[int]) -> Sequence[int]:
        """See `Engine`: submit an array of jobs, and take up those that an earlier one left."""
        try:
            self._submit(parts)
        except SettingError as error:
            if not self._accepted:  # no such partition, for one
                raise
            print(f"{error}; it is tried again", file=sys.stderr)
            return [part for part in parts if part in self._jobs]
        self._accepted = True
        return parts

    def _submit(self, parts: Sequence[int]) -> None:
        """Have a job for each of these parts.

        Raises:
            SettingError: SLURM does not answer, or refuses them.
        """
        states, new = job_states(), []
        for part in parts:
            before = self._submitted(part)
            if before and states.get(before, "CANCELLED") not in GONE:
                self._jobs[part] = before
            else:
                new.append(part)
        if not new:
            return
        carried = carried_environment()
        orders = [self._launch.order(part, self._cores, carried) for part in new]
        try:
            with self._executor.batch():
                jobs = [self._executor.submit(PartJob(order)) for order in orders]
        except (RuntimeError, OSError) as error:  # submitit's, with all that sbatch says
            said = [line for line in str(error).splitlines() if "error: " in line]
            text = " ".join(said or str(error).splitlines()[:1])
            raise SettingError(f"on: SLURM refuses the jobs: {text[:500]}") from None
        for part, job in zip(new, jobs, strict=True):
            self._jobs[part] = job.job_id
            append_event(self._launch.record(part), "submitted", job=job.job_id)

    def _submitted(self, part: int) -> str | None:
        """The job that was last submitted for a part."""
        entries = events(self._launch.record(part))
        jobs = [entry.get("job") for entry in entries if entry["event"] == "submitted"]
        return str(jobs[-1]) if jobs else None

    def ended(self) -> dict[int, Ended]:
        """See `Engine`."""
        now = time.monotonic()
        if not self._jobs or now - self._asked < SQUEUE_SECONDS:
            return {}
        self._asked = now
        try:
            states = job_states()
        except SettingError:  # the controller is busy; its jobs go on
            return {}
        ended = {}
        for part, job in list(self._jobs.items()):
            state = states.get(job, "gone")
            self._missed[part] = self._missed.get(part, 0) + 1 if state in (*GONE, "gone") else 0
            code = last_code(self._launch.record(part))
            settled = next_step(code, 0) is Step.DONE
            # A job that is requeued may be away for a moment.
            if self._missed[part] >= (1 if settled else 2):
                del self._jobs[part], self._missed[part]
                cancelled = state == "CANCELLED"
                ended[part] = Ended(
                    ExitCode.STOPPED if cancelled and code is None else code, cancelled
                )
        return ended

    def stop(self) -> None:
        """See `Engine`: jobs go on without the launcher."""


def _new_folder(directory: Path) -> Path:
    """Make a folder for submitit in a launch's directory, which may come from anybody.

    Jobs unpickle what lies there under their numbers, which can be guessed, so that it has to be a
    folder to which nobody else has written. Jobs of an earlier launcher keep theirs.

    Raises:
        SettingError: it cannot be made.
    """
    try:
        (directory / SLURM).mkdir(mode=0o700, exist_ok=True)
        return Path(tempfile.mkdtemp(dir=directory / SLURM))
    except OSError as error:
        raise SettingError(f"out: cannot write to {directory}: {error.strerror}") from None


def _entering(directory: Path) -> str:
    """A line of a job's script that enters a directory, or `ELSEWHERE` if it is not there.

    SLURM goes to /tmp then, where anybody may have put what Python imports from where it is
    started.
    """
    return f"cd -- {shlex.quote(str(directory))} 2>/dev/null || cd {shlex.quote(ELSEWHERE)}"


def _megabytes(resources: Resources) -> str | None:
    """Memory of a job, as sbatch has it."""
    return None if resources.memory is None else f"{int(resources.memory * 2**10)}M"


def job_states() -> dict[str, str]:
    """The states of this user's jobs, those that ended a while ago aside.

    Raises:
        SettingError: SLURM does not answer.
    """
    command = ["squeue", "--noheader", "--array", "--me", "--states=all", "--format=%i|%T"]
    try:
        answer = _answer(command)
    except _NoAnswerError as error:
        raise SettingError(f"on: SLURM does not answer: {error}") from None
    pairs = (line.strip().partition("|") for line in answer.splitlines())
    return {job: state for job, _, state in pairs if job}


class _NoAnswerError(Exception):
    """A command of SLURM's has failed; in one line, why."""


def _answer(command: Sequence[str]) -> str:
    """What a command of SLURM's prints.

    Raises:
        _NoAnswerError: it fails.
    """
    try:
        result = subprocess.run(command, capture_output=True, text=True, timeout=90, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise _NoAnswerError(str(error)) from None
    if result.returncode:
        raise _NoAnswerError(" ".join(result.stderr.split())[:300])
    return result.stdout


def sbatch_options(texts: Sequence[str]) -> dict[str, Any]:
    """KEY=VALUE texts as options of sbatch; a KEY alone is a flag.

    Raises:
        SettingError: one is none that a launch may have.
    """
    options: dict[str, Any] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if key not in SBATCH:
            raise SettingError(f"sbatch: {key!r:.40} is none of {', '.join(SBATCH)}")
        if not re.fullmatch(r"[\w.,:@+*/\[\]&|() -]*", value, re.ASCII):
            raise SettingError(f"sbatch: {value!r:.60} is no value for {key}")
        options[key] = value if equals else True
    return options
