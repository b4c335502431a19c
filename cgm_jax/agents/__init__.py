"""Agents: who learns.

protocol.py   what an agent offers to the loop
ddpg.py       deep deterministic policy gradient: the paper's agent
td3.py        twin delayed DDPG
sac.py        soft actor-critic with an automatic temperature
networks.py   shapes of actors and critics; products.py their matrix products
gradients.py  steps, target networks, rounds of updates

Every file with a class derived from `Agent` is a value of `--agent`.
"""
