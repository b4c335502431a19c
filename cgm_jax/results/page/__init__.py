"""The page: sweeps as one HTML file that needs no network (`python -m cgm_jax.report`).

sweeps.py    a run directory as the page needs it, read as untrusted input
settings.py  which settings tell its lines apart, and what they are called
series.py    a run's metrics as columns
success.py   final success, with intervals
data.py      all of it as plain values, in the form that js/ reads
videos.py    videos in run directories
page.py      the file: page.html with its style, programs and data put in

js/          what the page does in a browser; vendor/ the libraries it draws with
"""
