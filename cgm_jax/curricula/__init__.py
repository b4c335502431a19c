"""What to practise.

protocol.py   what a curriculum offers to the loop, and what it is told
cgm.py        curriculum goal masking: the paper's
full.py       none: always the environment's own goal; uniform.py masks drawn uniformly
goid.py       goals of intermediate success; mega.py rare ones within reach; vds.py those that
              critics disagree about; starts.py starts of intermediate success
goals.py      masked goals, and when they are achieved
masks.py      all masks of a goal, and the paper's weights; history.py success rates
candidates.py what curricula over goals choose among, and its success; density.py kernel densities
recent.py     a ring of the last so many things of a kind

Every file with a class derived from `Curriculum` is a value of `--curriculum`.
"""
