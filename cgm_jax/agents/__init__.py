"""Who learns.

protocol.py   what an agent offers to the loop
ddpg.py       deep deterministic policy gradient: the paper's agent
networks.py   shapes of actor and critic; gradients.py steps and target networks

Every file with a class derived from `Agent` is a value of `--agent`.
"""
