"""Bytes that no device sends: typed faults only, and no value from outside the grammar.

20 000 strings a profile here; `make fuzz` runs a million.
"""

from __future__ import annotations

import os
import random
from decimal import Decimal
from functools import partial

import pytest

from drivers.profile import MILLIMETRES, Fault, IndicatorReading, Profile, Query, Spindle, Unit
from drivers.profiles import PROFILES
from drivers.twins import IndicatorTwin
from tests.drivers.shapes import SHAPES

COUNT = int(os.environ.get("GLIDECAL_FUZZ", "20000"))


def seeds_of(profile: Profile) -> list[bytes]:
    """Good and bad replies to start from."""
    replies = [bad.reply for bad in profile.bad_replies.values()]
    for position in (1.234, -0.5, 0.0):
        twin = IndicatorTwin(profile, Spindle(partial(float, position), 0.001))
        replies.append(twin.receive(profile.request(Query()) if profile.request else b""))
    return [reply.strip(b"\r\n") for reply in replies]


def mutated(generator: random.Random, seed: bytes) -> bytes:
    """A few bytes replaced, inserted, removed, or the end cut off."""
    line = bytearray(seed)
    for _ in range(generator.randint(1, 3)):
        at = generator.randrange(len(line) + 1)
        byte = generator.choice(b"0123456789+-. ,:AMmIN\x00\x8d\xff") if at % 2 else at * 37 % 256
        match generator.randrange(4):
            case 0:
                line[at : at + 1] = bytes([byte])
            case 1:
                line[at:at] = bytes([byte])
            case 2:
                del line[at : at + 1]
            case _:
                del line[at:]
    return bytes(line)


@pytest.mark.timeout(1200)
@pytest.mark.parametrize("profile", PROFILES.values(), ids=list(PROFILES))
def test_fuzz(profile: Profile) -> None:
    generator = random.Random(profile.name)
    seeds = seeds_of(profile)
    shape = SHAPES[profile.name]
    values = 0
    for _ in range(COUNT):
        if generator.random() < 0.4:
            line = generator.randbytes(generator.randrange(25))
        else:
            line = mutated(generator, generator.choice(seeds))
        text = line.decode("latin-1")
        outcome = profile.parse(text, Query())
        assert outcome is None or isinstance(outcome, IndicatorReading | Fault)
        if isinstance(outcome, IndicatorReading):
            values += 1
            match = shape.fullmatch(text)
            assert match, (profile.name, text)
            number = Decimal(match[1].replace(" ", ""))
            assert outcome.value_mm == float(number * MILLIMETRES[Unit.MM]), (profile.name, text)
    assert values > 0, "the mutations keep some replies whole, so some values are expected"
