# Two commands do everything: `make sweep` runs the main job, `make test` the tests. Both set up
# what they need first; a second call installs nothing.

PYTHON ?= python3
VENV := .venv
RUN := $(VENV)/bin/python
# Two processes of tests, a file in one of them, so that its tests share what they compile.
PARALLEL := --numprocesses 2 --dist loadfile

.PHONY: setup sweep test test-slow test-sb3 test-onnx pretrained faults lint bench transfer lock clean

setup: $(VENV)/.installed

$(VENV)/.installed: pyproject.toml requirements.lock
	$(PYTHON) -m venv $(VENV)
	$(RUN) -m pip install --quiet --disable-pip-version-check --requirement requirements.lock
	$(RUN) -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	touch $@

sweep: setup
	$(RUN) -m cgm_jax.sweep --preset quick $(ARGS)

test: lint
	$(RUN) -m pytest $(PARALLEL) -m "not slow" $(ARGS)

# What takes long: MJX, kill -9, memory. .ci/run runs both.
test-slow: setup
	$(RUN) -m pytest $(PARALLEL) -m slow $(ARGS)

# Stable-Baselines3 takes PyTorch, which is large, and so has an environment of its own. The networks
# are small: more threads than one would wait for each other most of the time.
test-sb3: $(VENV)-sb3/.installed
	OMP_NUM_THREADS=1 $(VENV)-sb3/bin/python -m pytest tests/envs/test_stable_baselines3.py \
	    tests/cgm_jax/gymnasium/test_stable_baselines3.py $(ARGS)

$(VENV)-sb3/.installed: requirements.lock tests/sb3-requirements.txt
	$(PYTHON) -m venv $(VENV)-sb3
	$(VENV)-sb3/bin/python -m pip install --quiet --disable-pip-version-check \
	    --requirement requirements.lock --requirement tests/sb3-requirements.txt
	touch $@

# onnx and onnxruntime are larger than all else that tests need.
test-onnx: $(VENV)-onnx/.installed
	$(VENV)-onnx/bin/python -m pytest tests/cgm_jax/results/test_onnx_model.py $(ARGS)

$(VENV)-onnx/.installed: requirements.lock tests/onnx-requirements.txt
	$(PYTHON) -m venv $(VENV)-onnx
	$(VENV)-onnx/bin/python -m pip install --quiet --disable-pip-version-check \
	    --requirement requirements.lock --requirement tests/onnx-requirements.txt
	touch $@

# The policies that come with the package: trains, chooses and measures them anew.
pretrained: setup
	$(RUN) -m experiments.pretrained $(ARGS)

# Fifty random sequences of signals, kills, full disks, torn and moved files. Takes an hour.
faults: setup
	$(RUN) -m tests.cgm_jax.faults --out experiments/results/faults/faults.csv $(ARGS)

lint: setup
	$(RUN) -m ruff check .
	$(RUN) -m ruff format --check .
	$(RUN) -m pyright

bench: setup
	$(RUN) -m cgm_jax.benchmark $(ARGS)

# Trained policies in Gymnasium-Robotics, whose MuJoCo is older and so has an environment of its own.
transfer: setup $(VENV)-transfer/.installed
	$(RUN) -m experiments.physics.transfer $(ARGS)

$(VENV)-transfer/.installed: experiments/physics/transfer-requirements.txt
	$(PYTHON) -m venv $(VENV)-transfer
	$(VENV)-transfer/bin/python -m pip install --quiet --disable-pip-version-check --requirement $<
	touch $@

# Resolves pyproject.toml anew; commit the result.
lock:
	$(PYTHON) -m venv $(VENV)-lock
	$(VENV)-lock/bin/python -m pip install --quiet pip-tools
	$(VENV)-lock/bin/pip-compile --quiet --extra dev --strip-extras --no-emit-index-url \
	    --no-emit-trusted-host --no-emit-find-links --no-header --output-file requirements.lock pyproject.toml
	rm -rf $(VENV)-lock

clean:
	rm -rf $(VENV) $(VENV)-sb3 $(VENV)-onnx $(VENV)-transfer .pytest_cache .ruff_cache
