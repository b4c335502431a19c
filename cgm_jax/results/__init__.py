"""What is made of runs.

figures.py     learning curves, epochs to 50 % over c_g, success per mask: from metrics.jsonl
plan.py        what policies are evaluated on
policies.py    success of exported policies, noise-free, with any mask
video.py       videos of their episodes
statistics.py  when a run reaches or holds a success
"""
