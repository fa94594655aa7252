"""Who may talk to the server: a program that only this person should see listens on a port that others can reach."""

from __future__ import annotations

import hmac
import ipaddress
import secrets
import socket
from urllib.parse import urlsplit

_ANY = ("0.0.0.0", "::", "")


class Access:
    """The rules for one server.

    host: the address that it listens on.
    token: the secret without which nothing is answered; also on this machine's own address, since others may have
    accounts on it.
    """

    def __init__(self, host: str, token: str | None = None) -> None:
        self.token = token or secrets.token_urlsafe(24)
        self._takes_any_address = host in _ANY
        self._names = {"localhost", "127.0.0.1", "::1", host.lower()} - {""}
        if self._takes_any_address:
            self._names.add(socket.gethostname().lower())

    def allows_host(self, host: str | None) -> bool:
        """Whether a request came for a name of this server.

        A page of an attacker can have a name that leads here (DNS rebinding), but it cannot change the Host header,
        which has that name. A plain address is no such name.
        """
        name = _hostname(host)
        if name is None:
            return False
        return name in self._names or (self._takes_any_address and _is_address(name))

    def allows_origin(self, origin: str | None, host: str | None) -> bool:
        """Whether the page that sends a request is our own. Browsers say where a page of another site comes from; what
        says nothing is no page of another site."""
        if origin is None:
            return True
        parts = urlsplit(origin)
        return parts.scheme in ("http", "https") and host is not None and parts.netloc.lower() == host.lower()

    def allows_token(self, token: str | None) -> bool:
        """Whether this is the token, in a time that tells nothing about it."""
        return token is not None and hmac.compare_digest(token.encode(), self.token.encode())


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach what listens there."""
    return host == "localhost" or (_is_address(host) and ipaddress.ip_address(host).is_loopback)


def _hostname(host: str | None) -> str | None:
    if host is None or set(host) & set("/?#@\\"):  # more than a name and a port
        return None
    try:
        return urlsplit(f"//{host}").hostname
    except ValueError:  # brackets without an address
        return None


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
