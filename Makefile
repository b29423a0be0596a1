# The two commands: make demo, make test. Everything else is below `make help`.
CARGO ?= cargo
PACKAGES := build-essential pkg-config libclang-dev libgphoto2-dev
MACHINE_PACKAGES := flex bison bc xz-utils dpkg-dev libexif-dev mmdebstrap e2fsprogs kmod procps systemd
# --cached: without the parts that need the virtual machine's kernel, where it is not built yet.
MACHINE_OPTIONS ?=
DEMO_OUTPUT ?= demo-output

.PHONY: help demo test lint bench package package-aarch64 test-machine build dependencies machine-dependencies

help:
	@echo 'make demo          a bundled flight through the real daemon; ends with a store and a report'
	@echo 'make test          formatting, lints, every test (Debian 12: installs what it lacks)'
	@echo 'make bench         the figures of docs/performance.md'
	@echo 'make package       a Debian package in target/package'
	@echo 'make package-aarch64  the same for aarch64, cross-built (as root)'
	@echo 'make test-machine  cameras, GPIO and systemd in virtual machines'

demo: build
	target/release/wingd demo --output $(DEMO_OUTPUT)

test: dependencies lint
	$(CARGO) test --release --locked

lint: dependencies
	$(CARGO) fmt --check
	$(CARGO) clippy --release --locked --all-targets -- -D warnings

build: dependencies
	$(CARGO) build --release --locked --bins

bench: build
	sh benches/run.sh

package: build
	sh packaging/build.sh

package-aarch64: machine-dependencies
	bash packaging/aarch64.sh

test-machine: machine-dependencies build
	bash tests/machine/run.sh $(MACHINE_OPTIONS)

# Installs the Debian packages that are missing, as root or through sudo; elsewhere says which.
dependencies:
	@sh packaging/dependencies.sh $(PACKAGES)

machine-dependencies:
	@sh packaging/dependencies.sh $(PACKAGES) $(MACHINE_PACKAGES)
