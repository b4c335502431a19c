"""What is made of results: figures, measured policies, films.

figures.py     learning curves, epochs to 50 % over c_g, success per mask: from metrics.jsonl
evaluation.py  success of exported policies, noise-free, with any mask
video.py       films of their episodes
"""
