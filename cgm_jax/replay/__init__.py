"""What is replayed.

ring.py         the ring buffer of whole episodes that hindsight draws from
relabelling.py  hindsight experience replay: goals that were reached later
"""
