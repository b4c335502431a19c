"""Gymnasium's goal environments as tasks to train on: `--env gymnasium:ID`.

task.py    what JAX sees: a `GoalEnvironment` whose rows live in another process
process.py that process, from this side: messages, and its end
worker.py  the same from its own side; needs numpy and gymnasium, and nothing of ours
rows.py    rows of an environment there: reset, step, success; and what is known of it
probe.py   whether it is fit to be trained on, by its spaces and one episode
rule.py    when a goal counts as achieved

A process of its own, since a callback of XLA's must not run JAX itself, as many environments do; so
that another interpreter can have another MuJoCo; and so that what is printed there is harmless.
"""
