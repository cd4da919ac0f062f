# Copyright 2026 The hapticvision_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.


# `make demo` and `make test` are all that is needed; both set up .venv first.

BIN := .venv/bin

# A parent in another ROS environment hands down its library and module paths: they are not ours.
ifneq ($(_ROS_WHEELS_BOOTSTRAP_COMPLETE)$(AMENT_PREFIX_PATH),)
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE AMENT_PREFIX_PATH LD_LIBRARY_PATH PYTHONPATH
endif
unexport PYTHONHOME RMW_IMPLEMENTATION VIRTUAL_ENV
export ROS_AUTOMATIC_DISCOVERY_RANGE := LOCALHOST

.PHONY: help demo test setup lint format lock bench clean

help: ## Say what there is.
	@sed -n 's/^\([a-z]*\):.*## \(.*\)/  make \1\t\2/p' Makefile | expand -t 16

demo: setup ## Run an experiment on the simulated cell, fit it and real data, write out/demo.
	@$(BIN)/hapticvision demo --out out/demo $(if $(SILICONE),--silicone "$(SILICONE)")

test: setup ## Run all tests, the linters among them, on two processors.
	@# Live tests mostly wait: three workers keep two processors busy.
	@$(BIN)/python -m pytest -n 3 --dist loadgroup --no-loadscope-reorder

setup: ## Make .venv from requirements.lock, unless it is there.
	@tools/setup.sh

lint: setup ## Run the linters only.
	@$(BIN)/python -m pytest -q test/test_lint.py

format: setup ## Let ruff sort imports and lay out the code.
	@$(BIN)/ruff check --fix .
	@$(BIN)/ruff format .

lock: setup ## Turn requirements.in into requirements.lock: newest versions, with hashes.
	@$(BIN)/uv pip compile --quiet --upgrade --generate-hashes --no-header --no-annotate \
	  --python-version 3.12 --python-platform x86_64-manylinux_2_28 \
	  --output-file requirements.lock requirements.in

bench: setup ## Run the benchmarks: ratios, measured side by side.
	@for script in bench/bench_*.py; do echo "== $$script"; $(BIN)/python "$$script" || exit 1; done

clean: ## Remove .venv and everything that was made.
	rm -rf .venv out build install log *.egg-info .pytest_cache .mypy_cache .ruff_cache \
	  .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
