"""What curricula are made of; each serves several, or one that would not fit its own file.

masks.py         all masks of a goal, and the paper's weights
lookahead.py     the same without a table of all masks; levels.py difficulty first
history.py       success rates over evaluation episodes; windows.py of each mask over its latest
candidates.py    what curricula over goals choose among, and its success
density.py       kernel densities; recent.py a ring of the last so many things of a kind
rows.py          rows of two batches, by a condition
"""
