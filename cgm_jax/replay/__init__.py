"""What is replayed.

ring.py      the ring buffer of whole episodes that hindsight draws from
protocol.py  what a way to relabel offers to the loop
future.py    hindsight experience replay: goals that were reached later

Every file with a class derived from `Relabelling` is a value of `--relabelling`.
"""
