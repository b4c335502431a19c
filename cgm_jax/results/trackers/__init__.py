"""Where `--track NAME` sends a sweep: settings, metrics, figures and a video of the best policy.

A tracker is one file with one class, whose protocol is in protocol.py; the file's name is the
option's value. FILE.py:NAME is a class of the user's own. results/tracking.py feeds them.

tensorboard.py  event files in the run directory, by TensorBoard's own writer
wandb.py        Weights & Biases, offline unless WANDB_MODE says otherwise
trackio.py      trackio's database on this machine
"""
