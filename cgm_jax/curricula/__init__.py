"""What to practise. A curriculum is a file, and the file's name is the option's value.

protocol.py      what a curriculum offers to the loop, and what it is told
full.py          the environment's own goals, whole
uniform.py       masks drawn uniformly
cgm.py           masks near a chosen success rate (the paper's)
learnability.py  masks that succeed sometimes
progress.py      masks whose success changes
accuracy.py      distance thresholds whose success changes

masks.py         all masks of a goal in a table; lookahead.py and levels.py: without a table
history.py       success rates over evaluation episodes
windows.py       success rates over training episodes, and how they change
"""
