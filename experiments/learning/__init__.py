"""Questions of learning: does CGM help, which c_g and kappa, which masks?

From plan to record:

    plans.py               what is to be trained: plans.toml, with every setting written out
    train.py               trains sweeps, one after the other or several at a time
    records.py             what is committed of a trained sweep, and how it is read back

From record to report:

    setting.py             what the seeds of a line have in common, decided in one place
    tables.py              how soon runs hold a success, and where they end
    paired.py              curricula compared by seed, with intervals and exact tests
    comparison.py          the paper's Fig. 4: success over training
    overview.py            many settings beside each other, with every seed
    report_tables.py       tables of the report
    report_values.py       numbers in its sentences

    sliders.py             an environment: goals of twenty dimensions
    calibration.py         how far estimates of success are off: a program of its own
    calibration_errors.py  the errors in its table
    seconds.py             how long the preset cpu takes to 90 %: a program of its own
"""
