"""What is replayed.

ring.py      the ring buffer of whole episodes that hindsight draws from
protocol.py  what a way to relabel offers to the loop
future.py    hindsight experience replay: goals that were reached later
relay.py     the same for stages on the way to the goal, which exploration pursues first

Every file with a class derived from `Relabelling` is a value of `--relabelling`.
"""
