"""What browsers may send, and what pictures look like on the way to them."""

import numpy as np
import pytest
from fastcollide.view.messages import HEADER, MAGIC, InvalidMessage, pack_picture, read_message
from fastcollide.view.moments import Box, Moment


@pytest.mark.parametrize(
    "text",
    [
        '{"type": "play"}',
        '{"type": "ack"}',
        '{"type": "seek", "index": 12}',
        '{"type": "speed", "factor": 2}',
        '{"type": "color", "by": "contacts"}',
        '{"type": "select", "id": null}',
        '{"type": "change", "gravity": [0, 0, 1.5], "restitution": 0}',
    ],
)
def test_good_messages(text):
    assert read_message(text).type in text


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "message: Invalid JSON"),
        ("{", "message: Invalid JSON"),
        ("[]", "message"),
        ("null", "message"),
        ('"play"', "message"),
        ("{}", "type"),
        ('{"type": "shutdown"}', "shutdown"),
        ('{"type": "play", "extra": 1}', "play.extra"),
        ('{"type": "seek"}', "seek.index"),
        ('{"type": "seek", "index": -1}', "seek.index"),
        ('{"type": "seek", "index": 1.5}', "seek.index"),
        ('{"type": "seek", "index": "1"}', "seek.index"),
        ('{"type": "seek", "index": 99999999999999999999}', "seek.index"),
        ('{"type": "select", "id": true}', "select.id"),
        ('{"type": "speed", "factor": 0}', "speed.factor"),
        ('{"type": "speed", "factor": NaN}', "speed"),
        ('{"type": "color", "by": "mass"}', "color.by"),
        ('{"type": "change"}', "nothing to change"),
        ('{"type": "change", "gravity": [0, 0]}', "change.gravity"),
        ('{"type": "change", "gravity": [0, 0, 1e300]}', "change.gravity.2"),
        ('{"type": "change", "gravity": [0, 0, Infinity]}', "change.gravity.2"),
        ('{"type": "change", "drag": -1}', "change.drag"),
        ('{"type": "change", "restitution": 1.01}', "change.restitution"),
        ('{"type": "change", "friction": -0.1}', "change.friction"),
        ('{"type": "change", "device": "cuda"}', "change.device"),
    ],
)
def test_bad_messages_are_named(text, message):
    with pytest.raises(InvalidMessage, match=message) as raised:
        read_message(text)
    assert len(str(raised.value)) < 300


@pytest.mark.parametrize("with_radii", [True, False])
@pytest.mark.parametrize("with_values", [True, False])
def test_a_picture_comes_back_as_it_was(with_radii, with_values):
    random = np.random.default_rng(1)
    positions, radii, values = (random.random(shape, dtype=np.float32) for shape in ((5, 3), 5, 5))
    moment = Moment(42, 0.7, Box(((0, 0, 0), (1, 1, 1)), ("open",) * 3), positions, positions, radii)
    packed = pack_picture(moment, 3, 9, values if with_values else None, with_radii=with_radii)

    magic, frame, index, moments, count, follows, time = HEADER.unpack_from(packed)
    assert (magic, frame, index, moments, count, time) == (MAGIC, 42, 3, 9, 5, 0.7)
    assert follows == with_radii + 2 * with_values
    expected = [positions.ravel(), *([radii] if with_radii else []), *([values] if with_values else [])]
    np.testing.assert_array_equal(np.frombuffer(packed, "<f4", offset=HEADER.size), np.concatenate(expected))
    assert HEADER.size % 8 == 0  # a Float32Array cannot start elsewhere
