"""The report's command line: values in a fixed order."""

from pathlib import Path

import pytest
from fastcollide.parameters import InvalidSetting
from fastcollide.positional import is_positional, parse_positional
from fastcollide.settings import RunSettings

EXAMPLE = ["2000", "600", "60", "2", "-9.8", "0.999", "0.6", "output", "video.mp4", "1"]


def test_each_value_lands_in_its_setting():
    values = ["7", "90", "30", "3", "-1.6", "0.5", "0.25", "folder", "film.mp4", "0"]

    settings = parse_positional(values)

    assert settings == RunSettings(
        solver="reference",  # the report's program has the report's loop
        particles=7,
        frames=90,
        fps=30,
        export_every=3,
        gravity=-1.6,
        damping=0.5,
        floor_restitution=0.25,
        output=Path("folder"),
        video=Path("film.mp4"),
        make_video=False,
    )


@pytest.mark.parametrize("count", range(1, len(EXAMPLE) + 1))
def test_values_left_out_are_those_of_the_example(count):
    assert parse_positional(EXAMPLE[:count]) == parse_positional(EXAMPLE)


def test_the_example_gives_300_files_and_300_pictures_that_last_as_long_as_the_run():
    settings = parse_positional(EXAMPLE)
    frames = range(1, settings.frames + 1)

    exported = [frame for frame in frames if settings.is_export_due(frame)]
    drawn = [frame for frame in frames if settings.is_picture_due(frame)]

    assert exported == drawn == list(range(2, 601, 2))
    assert len(drawn) / settings.pictures_per_second == settings.seconds == 10


@pytest.mark.parametrize("first", ["2000", "0", "-5", "2e3", "nan"])
def test_a_number_comes_first(first):
    assert is_positional([first, "-9.8"])


@pytest.mark.parametrize("arguments", [[], ["run"], ["--test"], ["-h"], [""]])
def test_without_a_number_first_it_is_not_this_form(arguments):
    assert not is_positional(arguments)


@pytest.mark.parametrize(
    ("position", "text", "name"),
    [
        (0, "0", "particles"),
        (0, "2e3", "particles"),
        (1, "-1", "frames"),
        (2, "60.5", "fps"),
        (3, "-1", "export_every"),
        (4, "down", "gravity"),
        (4, "nan", "gravity"),
        (4, "-1000.5", "gravity"),
        (5, "0", "damping"),
        (5, "1.001", "damping"),
        (6, "-0.1", "floor_restitution"),
        (6, "inf", "floor_restitution"),
        (7, "", "output"),
        (8, "video.txt", "video"),
        (9, "2", "make_video"),
    ],
)
def test_a_wrong_value_is_named(position, text, name):
    values = EXAMPLE[:position] + [text] + EXAMPLE[position + 1 :]

    with pytest.raises(InvalidSetting) as caught:
        parse_positional(values)

    assert caught.value.name == name
    assert text in str(caught.value)
    assert "allowed: " in str(caught.value)


def test_an_eleventh_value_is_refused():
    with pytest.raises(InvalidSetting, match="found 11 values"):
        parse_positional([*EXAMPLE, "1"])
