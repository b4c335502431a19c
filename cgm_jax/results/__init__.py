"""What is made of runs.

figures/       learning curves, epochs to 50 % over c_g, masks, what curricula report
page/          sweeps as one HTML file, to be read in a browser
parts.py       parts of a sweep, read and checked; same_names.py names of own code in them
merging.py     one run directory from them; merged_provenance.py what it was trained with
policies.py    success of exported policies, noise-free, with any mask; plan.py what is asked for,
               chosen.py the policies that were chosen, planned_environment.py where they play,
               episodes.py how
onnx_model.py  a policy as an ONNX model
video.py       videos of their episodes; best_policy.py one of a sweep's best policy
tracking.py    what TensorBoard and others are sent; trackers/ each of them
statistics.py  when a run holds a success
"""
