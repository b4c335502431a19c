"""What is made of runs.

figures/       learning curves, epochs to 50 %, masks, what curricula report: from metrics.jsonl
policies.py    success of exported policies, noise-free, with any mask
video.py       videos of their episodes
statistics.py  when a run reaches or holds a success
"""
