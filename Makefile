# `make help` lists the targets: six for everybody, the others for maintainers.
CARGO ?= cargo
PACKAGES := build-essential pkg-config libclang-dev libgphoto2-dev
# What the pages' examples call besides.
TEST_PACKAGES := curl openssl python3 python3-jsonschema
MACHINE_PACKAGES := flex bison bc xz-utils dpkg-dev libexif-dev mmdebstrap e2fsprogs kmod procps systemd
# --cached: without the parts that need the virtual machine's kernel, where it is not built yet.
MACHINE_OPTIONS ?=
DEMO_OUTPUT ?= demo-output

# wingd for Python: an environment with the versions of python/constraints.txt, made once. Its commands call WINGD.
PYTHON_VENV := $(CURDIR)/target/python-venv
FLEET := $(CURDIR)/target/fleet
WINGD ?= $(CURDIR)/target/release/wingd
# A program of yours is taken as it is.
PROGRAM := $(if $(filter $(CURDIR)/target/release/wingd,$(WINGD)),build)
export RAY_USAGE_STATS_ENABLED := 0
# Threads of small matrices wait for each other on a busy machine.
export OPENBLAS_NUM_THREADS ?= 1
# Without any network but the loopback.
ALONE := $(PYTHON_VENV)/bin/python -m demo.alone

# What the demonstration needs: no cameras but replay, no boards, no Parquet.
DEMO_FEATURES := --no-default-features --features desk
# The recorder's program, without the commands of the desk.
BOARD := $(CURDIR)/target/board
BOARD_FEATURES := --no-default-features --features board

.PHONY: help demo test test-long test-mutations table check lint bench compare docs docs-figures pictures gallery test-browser browser-dependencies package package-desk package-aarch64 test-machine test-soak test-powercut test-python test-python-long constraints fleet-demo fleet-test fleet-growth build dependencies machine-dependencies

help:
	@echo 'make demo          a bundled flight through the real daemon; ends with a store and a report'
	@echo 'make build         the whole program: target/release/wingd'
	@echo 'make test          formatting, lints, every test (Debian 12: installs what it lacks)'
	@echo 'make bench         the figures of docs/performance.md'
	@echo 'make docs          all pages as a book: target/book/index.html'
	@echo 'make package       the on-board Debian package, in target/package'
	@echo
	@echo 'For maintainers:'
	@echo 'make build-board   the program of the on-board package: target/board/wingd'
	@echo 'make test-python   lints and tests of wingd for Python; make test-python-long: notebooks, fleet'
	@echo 'make test-long     the statistical tests with all their draws, 300 kills of the recorder'
	@echo 'make test-mutations  10,000 mutated installations, frames, measurements, configurations'
	@echo 'make table TABLE=name  a table of the pages that takes minutes to hours: tests/validation/tables'
	@echo 'make check         format, lints, unit tests and layers: what usually breaks, in a minute after a change'
	@echo 'make docs-figures  writes the figures of README and pages by their commands (OPTIONS=--check compares)'
	@echo 'make compare BASE=revision  judges the detection by images against that revision (OLD, NEW, OPTIONS; tests/compare)'
	@echo 'make package-desk  the workstation'"'"'s: the whole program and wingd for Python; packaging/Containerfile makes an image of it'
	@echo 'make package-aarch64  the same for aarch64, cross-built (as root)'
	@echo 'make test-browser  each interaction of a report, marking by clicking, the live page through its faults, in Chromium (installs it)'
	@echo 'make pictures      the screenshots of the pages: docs/images'
	@echo 'make gallery       docs/gallery.md with the figures of the notebooks, from this program'
	@echo 'make test-machine  cameras, GPIO and systemd in virtual machines'
	@echo 'make test-soak     30 minutes of flood, slow readers, hanging camera and full disk at once (MINUTES)'
	@echo 'make fleet-demo    two aircraft, two wings on this machine: S3 server, upload, another calibration, corrections, damage, report'
	@echo 'make fleet-test    upload broken off, workers killed, engines, schema (docs/fleet.md)'
	@echo 'make fleet-growth  questions to 20, 200 and 2,000 synthetic flights, timed'
	@echo 'make test-powercut  300 power cuts of a virtual machine, and the control without fsync'

# A target folder of its own: no build replaces another's program.
demo: dependencies
	$(CARGO) build --release --locked --bin wingd $(DEMO_FEATURES) --target-dir target/demo
	target/demo/release/wingd demo --output $(DEMO_OUTPUT)

# Lints and tests of one build: .ci/linted. It has made the program, too.
test: dependencies
	@sh packaging/dependencies.sh $(TEST_PACKAGES)
	$(CARGO) fmt --check
	RUSTC_WORKSPACE_WRAPPER=$(CURDIR)/.ci/linted $(CARGO) test --release --locked --all-targets --no-run
	RUSTC_WORKSPACE_WRAPPER=$(CURDIR)/.ci/linted $(CARGO) test --release --locked
	$(MAKE) test-python PROGRAM=

# Statistics with all their draws, 300 kills; in about half an hour.
test-long: dependencies
	WINGD_DRAWS=all $(CARGO) test --release --locked --test adjust --test detect
	WINGD_DRAWS=all $(CARGO) test --release --locked --test system -- kills_lose_nothing

# In about half an hour; WINGD_MUTATIONS=400 for a look.
test-mutations: dependencies
	WINGD_MUTATIONS=$${WINGD_MUTATIONS:-10000} $(CARGO) test --release --locked --test system -- --ignored --nocapture mutations

# effects, kinds, live, flight-priors, layout or modes; options are environment variables.
table: dependencies
	$(CARGO) run --release --locked --example tables -- $(TABLE)

# Incremental: after a change only what it touches is compiled again (and a little slower code is made).
check: export CARGO_INCREMENTAL = 1
check: lint
	$(CARGO) test --release --locked --lib --test layers

lint: dependencies
	$(CARGO) fmt --check
	$(CARGO) clippy --release --locked --all-targets -- -D warnings

build: dependencies
	$(CARGO) build --release --locked --bins

.PHONY: build-board
build-board: dependencies
	$(CARGO) build --release --locked --bin wingd $(BOARD_FEATURES) --target-dir $(BOARD)
	cp $(BOARD)/release/wingd $(BOARD)/wingd

bench: build
	@sh packaging/dependencies.sh python3-venv
	sh benches/run.sh

# Node 18, playwright-core in PLAYWRIGHT and a Chromium (CHROMIUM, /usr/bin/chromium). LOOK=folder keeps pictures of each state.
export PLAYWRIGHT ?= $(CURDIR)/target/playwright
PLAYWRIGHT_VERSION := 1.65.1
LOOK ?= target/browser
test-browser: demo build browser-dependencies
	node tests/browser/report.mjs $(DEMO_OUTPUT)/report.html $(LOOK)
	node tests/browser/mark.mjs target/release/wingd $(LOOK)
	node tests/live/page.js target/release/wingd $(LOOK)

# The screenshots of the pages, docs/images/*.png, from this program.
pictures: build browser-dependencies
	node tests/browser/pictures.mjs target/release/wingd docs/images

# The notebooks' figures, docs/images/gallery, and the page that shows them.
gallery: $(PYTHON_VENV)/installed-test $(PROGRAM)
	cd python && $(PYTHON_VENV)/bin/python -m demo.gallery $(WINGD) $(CURDIR)/docs

# Debian's browser; playwright-core without the browsers that it would download.
browser-dependencies:
	@[ -n "$(CHROMIUM)" ] || sh packaging/dependencies.sh chromium
	@command -v npm >/dev/null || sh packaging/dependencies.sh nodejs npm
	@[ -e $(PLAYWRIGHT)/node_modules/playwright-core ] || \
		npm install --prefix $(PLAYWRIGHT) --no-save --no-audit --no-fund --loglevel error playwright-core@$(PLAYWRIGHT_VERSION)

# mdBook, built once.
MDBOOK := target/mdbook/bin/mdbook
docs: $(MDBOOK)
	$(MDBOOK) build docs
	@echo target/book/index.html

# Builds the tests and benches, then runs them. The peers of the times: benches/peers.sh.
docs-figures: $(PROGRAM)
	@sh packaging/dependencies.sh python3-venv
	WINGD=$(WINGD) python3 tests/validation/figures.py $(OPTIONS)

$(MDBOOK):
	$(CARGO) install --quiet --locked --root target/mdbook mdbook --version 0.5.4

# OLD, NEW, BASE, OPTIONS: see tests/compare/README.md.
compare:
	python3 tests/compare/compare.py $(or $(OLD),$$(tests/compare/base.sh $(BASE))) $(or $(NEW),target/release/wingd) $(OPTIONS)

package: build-board
	sh packaging/build.sh $(BOARD)/wingd

package-desk: build
	@sh packaging/dependencies.sh python3-venv
	sh packaging/desk.sh target/release/wingd

package-aarch64: machine-dependencies
	bash packaging/aarch64.sh

test-machine: machine-dependencies build-board build
	bash tests/machine/run.sh $(MACHINE_OPTIONS)

# See tests/soak/README.md.
MINUTES ?= 30
test-soak: build
	python3 tests/soak/soak.py --minutes $(MINUTES)

# CUTS, FS (ext4, vfat, exfat): see tests/powercut/README.md.
CUTS ?= 300
FS ?= ext4
test-powercut: build
	@sh packaging/dependencies.sh build-essential e2fsprogs procps
	bash tests/powercut/run.sh --cuts $(CUTS) --fs $(FS)
	bash tests/powercut/run.sh --cuts 20 --fs $(FS) --without-fsync

test-python: $(PYTHON_VENV)/installed-test $(PROGRAM)
	cd python && $(PYTHON_VENV)/bin/ruff format --check . && $(PYTHON_VENV)/bin/ruff check .
	cd python && WINGD=$(WINGD) PATH="$(PYTHON_VENV)/bin:$$PATH" $(PYTHON_VENV)/bin/python -m pytest

# Notebooks and the fleet: upload broken off, workers killed, engines, schema. FLEET_SLOW_LINK=1: 100 MB over 2 Mbit/s too, ten
# minutes more.
test-python-long: $(PYTHON_VENV)/installed-fleet-test $(PROGRAM)
	cd python && WINGD=$(WINGD) PATH="$(PYTHON_VENV)/bin:$$PATH" $(ALONE) $(PYTHON_VENV)/bin/python -m pytest -m long

fleet-test: $(PYTHON_VENV)/installed-fleet-test $(PROGRAM)
	cd python && WINGD=$(WINGD) PATH="$(PYTHON_VENV)/bin:$$PATH" $(ALONE) $(PYTHON_VENV)/bin/python -m pytest -m long tests/fleet

fleet-demo: $(PYTHON_VENV)/installed-demo $(PROGRAM)
	cd python && $(ALONE) $(PYTHON_VENV)/bin/python -m demo $(WINGD) $(FLEET)/demo

# 20, 200 and 2,000 synthetic flights: some minutes and 1 GB to make them.
fleet-growth: $(PYTHON_VENV)/installed-fleet-test $(PROGRAM)
	cd python && PATH="$(PYTHON_VENV)/bin:$$PATH" $(PYTHON_VENV)/bin/python -m demo.growth $(WINGD) $(FLEET)/growth

$(PYTHON_VENV)/installed-%: python/pyproject.toml python/constraints.txt
	@sh packaging/dependencies.sh python3-venv
	[ -e $(PYTHON_VENV)/bin/pip ] || python3 -m venv $(PYTHON_VENV)
	$(PYTHON_VENV)/bin/pip install --quiet --disable-pip-version-check --constraint python/constraints.txt --editable 'python[$*]'
	touch $@

# Writes python/constraints.txt from the newest versions that pyproject.toml permits.
constraints:
	rm -rf target/constraints
	python3 -m venv target/constraints
	target/constraints/bin/pip install --quiet --disable-pip-version-check './python[fleet-test,desk]'
	target/constraints/bin/pip freeze --exclude wingd > python/constraints.txt

# Installs the Debian packages that are missing, as root or through sudo; elsewhere says which.
dependencies:
	@sh packaging/dependencies.sh $(PACKAGES)

machine-dependencies:
	@sh packaging/dependencies.sh $(PACKAGES) $(MACHINE_PACKAGES)
