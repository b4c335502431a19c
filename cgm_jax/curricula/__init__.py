"""What to practise.

protocol.py   what a curriculum offers to the loop, and what it is told
cgm.py        curriculum goal masking: the paper's
full.py       none: always the environment's own goal; uniform.py masks drawn uniformly
goals.py      masked goals, and when they are achieved
masks.py      all masks of a goal, and the paper's weights; history.py success rates

Every file with a class derived from `Curriculum` is a value of `--curriculum`.
"""
