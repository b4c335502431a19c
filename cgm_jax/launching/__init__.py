"""Many processes for one sweep, on one machine or many: `python -m cgm_jax.launch`.

The sweep is cut into parts (config/shards.py), each of which a process of its own trains in a
directory of its own; in the end they are merged (results/merging.py). All of that must lie where
every machine reads and writes it.

    DIR/launch.json      what was launched
    DIR/parts/1/         the run directory of part 1, `cgm_jax.sweep --shard 1/N --out DIR/parts/1`
    DIR/attempts/1.jsonl its attempts: where each began, and its exit code (record.py)
    DIR/logs/1.log       what it printed
    DIR/config.json ...  the merged sweep, once all parts are done

plan.py         what is to be launched, from options; check.py whether its parts can be trained
directory.py    these paths, and the command of a part
attempts.py     one attempt at a part: a child process, its cores, its end, and whether to try again
record.py       what is written of attempts
supervision.py  what all engines share: attempts until every part is done or cannot be
merged.py       whether the sweep in a launch's directory is that of its parts
progress.py     one line for all parts, from their metrics.jsonl
cores.py        cores that no other attempt on the machine has

local.py        engine: processes on this machine, one per GPU or group of cores
slurm.py        engine: a SLURM job array, by submitit (extra `slurm`)
ray.py          engine: tasks on a Ray cluster (extra `ray`)
"""
