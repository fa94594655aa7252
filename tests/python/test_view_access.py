"""Who may talk to the server of the live page."""

import pytest
from fastcollide.view.access import Access, is_loopback


@pytest.mark.parametrize("host", ["127.0.0.1:8321", "localhost:8321", "LOCALHOST", "[::1]:8321", "localhost:9000"])
def test_names_of_this_machine(host):
    assert Access("127.0.0.1").allows_host(host)


@pytest.mark.parametrize(
    "host",
    [
        None,
        "",
        "evil.example",
        "evil.example:8321",
        "127.0.0.1.evil.example",
        "localhost.evil.example:8321",
        "localhost@evil.example",
        "192.168.1.7:8321",
        "[::1",
        "[evil]",
        "localhost/evil.example",
        "evil.example@localhost",
    ],
)
def test_other_names_are_refused(host):
    assert not Access("127.0.0.1").allows_host(host)


def test_a_server_of_all_addresses_takes_each_address_but_no_foreign_name():
    access = Access("0.0.0.0")
    assert access.allows_host("192.168.1.7:8321")
    assert access.allows_host("[fe80::1]:8321")
    assert access.allows_host("localhost:8321")
    assert not access.allows_host("evil.example:8321")


def test_a_server_of_one_address_takes_that_one():
    access = Access("192.168.1.7")
    assert access.allows_host("192.168.1.7:8321")
    assert not access.allows_host("192.168.1.8:8321")


@pytest.mark.parametrize(
    ("origin", "is_allowed"),
    [
        (None, True),
        ("http://localhost:8321", True),
        ("https://localhost:8321", True),
        ("http://localhost:8322", False),
        ("http://127.0.0.1:8321", False),
        ("http://evil.example", False),
        ("http://evil.example:8321", False),
        ("file://localhost:8321", False),
        ("null", False),
        ("", False),
    ],
)
def test_origins(origin, is_allowed):
    assert Access("127.0.0.1").allows_origin(origin, "localhost:8321") == is_allowed


def test_tokens():
    access = Access("127.0.0.1")
    assert access.allows_token(access.token)
    assert len(access.token) >= 32
    for other in (None, "", access.token[:-1], access.token + "x", "é", Access("127.0.0.1").token):
        assert not access.allows_token(other)


def test_loopback():
    assert [is_loopback(host) for host in ("127.0.0.1", "::1", "localhost", "0.0.0.0", "10.0.0.1", "example")] == [
        True,
        True,
        True,
        False,
        False,
        False,
    ]
