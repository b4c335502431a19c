"""Who learns, and what the networks see.

ddpg.py        actor and critic updates; networks.py their shape
normaliser.py  running mean and standard deviation of observations and goals
policy.py      trained policies as plain arrays
"""
