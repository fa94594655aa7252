"""What the tests of the program share: a folder of their own to stand in, and the program itself."""

import pytest
from fastcollide import cli


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def program(capfd, folder):
    """Runs the program in the folder; returns its exit code, standard output and standard error."""

    def run(*arguments):
        code = cli.main([str(argument) for argument in arguments])
        return code, *capfd.readouterr()

    return run
