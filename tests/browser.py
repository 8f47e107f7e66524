"""Headless browser driven through its debugging pipe: what a page shows once loaded, and what it fails to load."""

import contextlib
import functools
import http.server
import itertools
import json
import os
import select
import shutil
import subprocess
import threading
import time

PROGRAM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
_PATIENCE = 60.0  # seconds to wait for an answer, on a busy machine


class Browser:
    """One page of a browser.

    Attributes
    ----------
    errors : list of str
        Resources missing from the page and exceptions thrown by it since it was opened.
    """

    def __init__(self, folder):
        ours, theirs = os.pipe(), os.pipe()
        command = [PROGRAM, "--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-pipe"]
        command += [f"--user-data-dir={folder}", "--no-first-run", "--disable-background-networking", "about:blank"]
        script = f'exec "$@" 3<&{ours[0]} 4>&{theirs[1]}'
        self._process = subprocess.Popen(
            ["bash", "-c", script, "browser", *command],
            pass_fds=(ours[0], theirs[1]),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(ours[0])
        os.close(theirs[1])
        self._write, self._read, self._held = ours[1], theirs[0], b""
        self._numbers, self._session, self._loaded = itertools.count(1), None, False
        self.errors = []
        target = self._ask("Target.createTarget", url="about:blank")["targetId"]
        self._session = self._ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self._ask(f"{domain}.enable")

    def close(self):
        """Terminate the browser."""
        self._process.kill()
        self._process.wait()
        os.close(self._write)
        os.close(self._read)

    def open(self, address):
        """Load a page with all its resources."""
        self.errors, self._loaded = [], False
        self._ask("Page.navigate", url=address)
        while not self._loaded:
            self._take(self._message())

    def ask(self, expression):
        """Return the value of a JavaScript expression on the page."""
        found = self._ask("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def wait(self, expression):
        """Wait until an expression is true and return its value."""
        end = time.monotonic() + _PATIENCE
        while not (value := self.ask(expression)):
            assert time.monotonic() < end, f"never: {expression}"
            time.sleep(0.05)
        return value

    def _ask(self, method, **options):
        number = next(self._numbers)
        message = {"id": number, "method": method, "params": options}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        while (answer := self._message()).get("id") != number:
            self._take(answer)
        assert "error" not in answer, answer
        return answer["result"]

    def _message(self):
        end = time.monotonic() + _PATIENCE
        while b"\0" not in self._held:
            ready, _, _ = select.select([self._read], [], [], max(0.0, end - time.monotonic()))
            part = os.read(self._read, 1 << 20) if ready else b""
            assert part, "the browser does not answer"
            self._held += part
        message, _, self._held = self._held.partition(b"\0")
        return json.loads(message)

    def _take(self, event):
        method, told = event.get("method"), event.get("params", {})
        self._loaded |= method == "Page.loadEventFired"
        if method == "Network.loadingFailed":
            self.errors.append(told["errorText"])
        if method == "Network.responseReceived" and told["response"]["status"] >= 400:
            self._miss(f"{told['response']['status']} {told['response']['url']}")
        if method == "Runtime.exceptionThrown":
            self.errors.append(told["exceptionDetails"]["text"])
        if method == "Log.entryAdded" and told["entry"]["level"] == "error":
            self._miss(f"{told['entry']['text']} {told['entry'].get('url', '')}")

    def _miss(self, what):
        """Record a missing resource, except for the tab's icon, which the browser requests of its own accord."""
        if not what.endswith("/favicon.ico"):
            self.errors.append(what)


@contextlib.contextmanager
def served(folder):
    """Serve a folder on this machine only and yield its address."""

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *given):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=str(folder))) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}"
        finally:
            server.shutdown()
