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

parts/ is what curricula are made of.

Every file with a class derived from `Curriculum` is a value of `--curriculum`.
"""
