"""What to practise. protocol.py says what a curriculum offers to the loop, and what it is told.

Over masks, which make goals easier:

    cgm.py           near a chosen success rate: curriculum goal masking, the paper's
    learnability.py  that sometimes succeed; progress.py whose success changes
    uniform.py       any; full.py none, always the environment's own goal

Over accuracy, goals and starts:

    accuracy.py      distance thresholds whose success changes
    goid.py          goals of intermediate success; mega.py rare ones within reach
    vds.py           goals about which critics disagree
    starts.py        starts of intermediate success

What they are made of:

    goals.py         masked goals, and when they are achieved
    masks.py         all masks of a goal, and the paper's weights
    lookahead.py     the same without a table of all masks; levels.py difficulty first
    history.py       success rates over evaluation episodes; windows.py over training episodes
    candidates.py    what curricula over goals choose among, and its success
    density.py       kernel densities; recent.py a ring of the last so many things of a kind

Every file with a class derived from `Curriculum` is a value of `--curriculum`.
"""
