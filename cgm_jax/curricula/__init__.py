"""What to practise.

protocol.py      what a curriculum offers to the loop, and what it is told
cgm.py           curriculum goal masking: the paper's
full.py          none: always the environment's own goal; uniform.py masks drawn uniformly
learnability.py  masks that sometimes succeed; progress.py masks whose success changes
accuracy.py      distance thresholds whose success changes
goals.py         masked goals, and when they are achieved
masks.py         all masks of a goal, and the paper's weights
lookahead.py     the same without a table of all masks; levels.py difficulty first
history.py       success rates over evaluation episodes; windows.py over training episodes

Every file with a class derived from `Curriculum` is a value of `--curriculum`.
"""
