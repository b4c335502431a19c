"""What is made of results: figures, statistics, measured policies, films.

figures.py     learning curves, epochs to 50 % over c_g, success per mask: from metrics.jsonl
statistics.py  when a run reaches or holds a success; intervals of success rates
evaluation.py  success of exported policies, noise-free, with any mask
video.py       films of their episodes
"""
