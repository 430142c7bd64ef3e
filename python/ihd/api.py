"""HTTP and server-sent events of a daemon, by the standard library."""

from __future__ import annotations

import http.client
import json
import os
import ssl
from collections.abc import Iterator
from typing import Any
from urllib.parse import urlsplit

_TIMEOUT_S = 25.0
"""Longest wait for an answer; the daemon's own is shorter."""

_SILENCE_S = 45.0
"""Silence after which a stream counts as lost: three heartbeats."""

_LOOPBACK = {"127.0.0.1", "::1", "localhost"}

Report = dict[str, Any]
"""An answer of the daemon, as `openapi.json` there describes it."""


class DaemonError(Exception):
    """The daemon refused, or did not answer."""

    def __init__(self, message: str, code: str = "unreachable", status: int | None = None) -> None:
        super().__init__(message)
        self.code = code
        """The API's code, such as "no-device"; "unreachable" without an answer."""
        self.status = status
        """HTTP status; `None` without an answer."""


class LeaseError(DaemonError):
    """Another client holds the lease, or this one has lost it."""


class Client:
    """HTTP client of one daemon: no proxy, no redirection, a connection for each request."""

    def __init__(self, url: str, token: str | None, ca: str | os.PathLike[str] | None) -> None:
        parts = urlsplit(url)
        if parts.scheme not in ("http", "https") or not parts.hostname or parts.path.rstrip("/") or parts.query:
            raise ValueError(f"{url}: must be an address like http://127.0.0.1:8731 or https://hob.lan:8731")
        self.url = url.rstrip("/")
        self._host, self._port = parts.hostname, parts.port
        token = token if token is not None else os.environ.get("IHD_TOKEN")
        # As read from a file, with its line's end.
        self._token = None if token is None else token.strip()
        if self._token is not None and not (self._token.isascii() and self._token.isprintable()):
            raise ValueError("the token holds characters that no token has")
        self._tls: ssl.SSLContext | None = None
        if parts.scheme == "https":
            if ca is None:
                raise ValueError("https needs ca=, the file with the daemon's certificate (STORE/tls/certificate.pem)")
            self._tls = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
            self._tls.load_verify_locations(os.fspath(ca))
        elif self._token is not None and self._host not in _LOOPBACK:
            raise ValueError(f"{url}: a token goes over https alone")

    def get(self, path: str) -> Any:
        """The answer to a GET."""
        return self.request("GET", path)

    def request(
        self,
        method: str,
        path: str,
        body: Report | None = None,
        holder: str | None = None,
        timeout_s: float = _TIMEOUT_S,
    ) -> Any:
        """The daemon's answer; raises `DaemonError`."""
        connection, response = self._send(method, path, body, holder, timeout_s)
        try:
            return self._answer(response)
        except (OSError, http.client.HTTPException) as why:
            raise self.unreachable(why) from why
        finally:
            connection.close()

    def _send(
        self, method: str, path: str, body: Report | None, holder: str | None, timeout_s: float
    ) -> tuple[http.client.HTTPConnection, http.client.HTTPResponse]:
        connection: http.client.HTTPConnection
        if self._tls is None:
            connection = http.client.HTTPConnection(self._host, self._port, timeout=timeout_s)
        else:
            connection = http.client.HTTPSConnection(self._host, self._port, timeout=timeout_s, context=self._tls)
        headers = {"content-type": "application/json"} if body is not None else {}
        if holder is not None:
            headers["ihd-holder"] = holder
        if self._token is not None:
            headers["authorization"] = f"Bearer {self._token}"
        try:
            data = None if body is None else json.dumps(body)
            connection.request(method, "/api/v1" + path, data, headers)
            return connection, connection.getresponse()
        except (OSError, http.client.HTTPException) as why:
            connection.close()
            raise self.unreachable(why) from why

    def _answer(self, response: http.client.HTTPResponse) -> Any:
        text = response.read()
        try:
            answer = json.loads(text) if text else None
        except ValueError:
            answer = None
        if 200 <= response.status < 300 and (answer is not None or not text):
            return answer
        if not isinstance(answer, dict) or "message" not in answer:
            raise DaemonError(f"{self.url} is no daemon of ihd: HTTP status {response.status}", "unexpected", response.status)
        code = str(answer.get("error"))
        kind = LeaseError if code == "leased" else DaemonError
        raise kind(str(answer["message"]), code, response.status)

    def stream(self, path: str) -> Stream:
        """Server-sent events, from now on."""
        # Sent at once, not with the first item: what happens after the call is seen.
        connection, response = self._send("GET", path, None, None, _SILENCE_S)
        if response.status != 200:
            try:
                self._answer(response)
            finally:
                connection.close()
            raise DaemonError(f"{self.url} sends no events", "unexpected", response.status)
        return Stream(self, connection, response)

    def unreachable(self, why: Exception) -> DaemonError:
        """Error for a request without an answer."""
        return DaemonError(f"no answer from the daemon at {self.url}: {why}")


class Stream(Iterator[Report]):
    """Server-sent events as an iterator, until the daemon ends or `close`; for a `with` block, too."""

    def __init__(
        self, client: Client, connection: http.client.HTTPConnection, response: http.client.HTTPResponse
    ) -> None:
        self._client = client
        self._connection = connection
        self._response = response

    def __next__(self) -> Report:
        try:
            item = self._read()
        except (OSError, http.client.HTTPException, ValueError) as why:
            self.close()
            raise self._client.unreachable(why) from why
        if item is None:
            self.close()
            raise StopIteration
        return item

    def _read(self) -> Report | None:
        """The next event; `None` at the end of the stream."""
        kind, data = "", ""
        while line := self._response.readline(1 << 20):
            field, _, value = line.decode().rstrip("\r\n").partition(":")
            value = value.removeprefix(" ")
            if field == "event":
                kind = value
            elif field == "data":
                data += value
            elif not line.strip() and data:
                item = json.loads(data)
                # Of the events of `live`, "devices" is a list of reports.
                item = {"reports": item} if isinstance(item, list) else item
                return {"event": kind, **item} if kind else item
        return None

    def close(self) -> None:
        """Ends the stream."""
        self._response.close()
        self._connection.close()

    def __enter__(self) -> Stream:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __del__(self) -> None:
        self.close()
