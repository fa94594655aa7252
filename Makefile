# `make demo` and `make test` need Python, a C++ compiler and make; everything else is fetched into .venv. `make help`
# lists the rest. FASTCOLLIDE_CUDA=OFF leaves out CUDA and its compiler; FASTCOLLIDE_CUDA_ARCHITECTURES=90 builds for
# another card than the one found.
PYTHON ?= python3
FASTCOLLIDE_CUDA ?= AUTO

venv := $(CURDIR)/.venv
export PATH := $(venv)/bin:$(PATH)
export PIP_DISABLE_PIP_VERSION_CHECK := 1

# Only the card of this machine, which halves the compile time; without one the oldest card, whose PTX runs on all.
known_cards := 75 80 86 87 88 89 90 100 103 110 120 121
cards := $(sort $(filter $(known_cards),$(subst .,,$(shell nvidia-smi --query-gpu=compute_cap --format=csv,noheader 2>/dev/null))))
FASTCOLLIDE_CUDA_ARCHITECTURES ?= $(or $(cards),75)
export FASTCOLLIDE_CUDA

settings = CUDA=$(FASTCOLLIDE_CUDA) for $(FASTCOLLIDE_CUDA_ARCHITECTURES), C++ compiler $(CXX)
sources := CMakeLists.txt LICENSE README.md pyproject.toml tests/determinism/print_hash.cpp \
  $(shell find cmake include python src ! -path '*__pycache__*')

.PHONY: help demo test docs validate videos bench lint sanitize clean always
help:
	@echo "make demo      simulate 10,000 spheres for 5 s and make a video of them"
	@echo "make test      run every test"
	@echo "make docs      build the documentation into build/docs"
	@echo "make validate  compare with the literature: gases, packings, a hopper (5 to 20 minutes on 2 cores; DEVICE=cuda)"
	@echo "make videos    make a small video of each scene"
	@echo "make bench     measure this machine"
	@echo "make lint      format and check the sources"
	@echo "make sanitize  run the engine under the address, undefined behaviour and thread sanitizers"
	@echo "make clean     remove all that these made"

demo: .venv/installed
	@fastcollide run --particles 10000 --frames 300 --fps 60 --export-every 2 --output demo --video video.mp4

test: .venv/installed
	@echo "== C++ tests"
	@ctest --test-dir build/package --output-on-failure --no-tests=error
	@echo "== Python tests"
	@pytest

# A page or a docstring that Sphinx finds fault with, or a link that leads nowhere, is an error.
docs: .venv/installed
	@python -m sphinx --builder html --fail-on-warning --keep-going --nitpicky --quiet docs build/docs
	@echo "== Built build/docs/index.html"

# Pictures and table show what was found, in its band or not.
validate: .venv/installed
	@pytest tests/validation --device $(or $(DEVICE),cpu); found=$$?; python tools/draw_validation.py && exit $$found

videos: .venv/installed
	@python tools/make_videos.py

bench: .venv/installed
	@fastcollide --test

lint: .venv/linters
	@pre-commit run --all-files

sanitize: .venv/build-tools
	@for preset in cpu-asan cpu-tsan; do \
	  echo "== $$preset"; \
	  cmake --preset $$preset && cmake --build --preset $$preset && ctest --preset $$preset || exit 1; \
	done

clean:
	rm -rf .venv build demo videos video.mp4 docs/generated

# --- How .venv is made. Each file in it marks a step that is done. ---

.venv/created:
	@command -v $(PYTHON) >/dev/null || { echo "FastCollide needs Python 3.10 or newer: no $(PYTHON) found."; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' \
	  || { echo "FastCollide needs Python 3.10 or newer: found $$($(PYTHON) -V). Choose one: make PYTHON=..."; exit 1; }
	@command -v $(CXX) >/dev/null || command -v c++ >/dev/null \
	  || { echo "FastCollide needs a C++20 compiler: no $(CXX) found. Choose one: make CXX=..."; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null \
	  || { echo "This Python cannot make virtual environments. On Debian and Ubuntu: apt install python3-venv"; exit 1; }
	@echo "== Making a virtual environment in .venv"
	@$(PYTHON) -m venv $(venv)
	@touch $@

# What `pip install .` would fetch for its build, asked of the build backend so that it stands in one place.
.venv/build-tools: .venv/created build/settings pyproject.toml
	@echo "== Fetching build tools ($(settings))"
	@pip install --quiet scikit-build-core nanobind
	@python -c 'from scikit_build_core import build; print(*build.get_requires_for_build_wheel(), sep="\n")' >build/requirements.txt
	@pip install --quiet --requirement build/requirements.txt
	@touch $@

.venv/installed: .venv/build-tools $(sources)
	@echo "== Building and installing fastcollide (a minute or two; some minutes with the CUDA code)"
	@SKBUILD_BUILD_DIR=build/package \
	SKBUILD_CMAKE_DEFINE="FASTCOLLIDE_BUILD_TESTS=ON;FASTCOLLIDE_CUDA=$(FASTCOLLIDE_CUDA);FASTCOLLIDE_CUDA_ARCHITECTURES=$(subst ;, ,$(FASTCOLLIDE_CUDA_ARCHITECTURES))" \
	  pip install --quiet --no-build-isolation ".[docs,files,plot,video,view,test]"
	@python -c 'import fastcollide; cuda = fastcollide.build_info().cuda; print("== Built", f"for CUDA {cuda}" if cuda else "without CUDA")'
	@touch $@

.venv/linters: .venv/created
	@pip install --quiet pre-commit
	@touch $@

# Changes only when what it says changes.
build/settings: always
	@mkdir -p build
	@[ "$$(cat $@ 2>/dev/null)" = "$(settings)" ] || echo "$(settings)" >$@
