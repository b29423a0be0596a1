"""TCP proxy on the loopback interface that breaks or slows a connection."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable

HOST = "127.0.0.1"
BUFFER_BYTES = 64 << 10


class Proxy:
    """Forwards connections to a port; after `budget` bytes towards it calls `broken` and blocks. `rate`: maximum bytes per second
    towards it, over all connections."""

    def __init__(self, port: int, rate: float | None = None):
        self.target, self.rate, self.free = port, rate, time.monotonic()
        self.passed = 0
        self.budget: int | None = None
        self.broken: Callable[[], None] = lambda: None
        self.lock = threading.Lock()
        self.listener = socket.create_server((HOST, 0))
        if rate:
            # Small socket buffers: large ones would hide the slow link.
            self.listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
        self.port = self.listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self.listener.accept()
            except OSError:
                return
            if self.budget is not None and self.budget <= 0:
                client.close()
                continue
            server = socket.create_connection((HOST, self.target))
            threading.Thread(target=self._pump, args=(client, server, True), daemon=True).start()
            threading.Thread(target=self._pump, args=(server, client, False), daemon=True).start()

    def _pump(self, source: socket.socket, sink: socket.socket, counted: bool) -> None:
        try:
            while data := source.recv(16_384):
                if counted and not self._count(len(data)):
                    break
                if counted and self.rate:
                    self._wait(len(data))
                sink.sendall(data)
        except OSError:
            pass
        finally:
            for one in (source, sink):
                try:
                    one.shutdown(socket.SHUT_RDWR)
                except OSError:
                    pass
                one.close()

    def _wait(self, length: int) -> None:
        with self.lock:
            turn = max(self.free, time.monotonic())
            self.free = turn + length / self.rate
        time.sleep(max(0.0, turn + length / self.rate - time.monotonic()))

    def _count(self, length: int) -> bool:
        with self.lock:
            self.passed += length
            if self.budget is None:
                return True
            before, self.budget = self.budget, self.budget - length
            left = self.budget > 0
            if before > 0 and not left:
                self.broken()
            return left

    def close(self) -> None:
        self.listener.close()
