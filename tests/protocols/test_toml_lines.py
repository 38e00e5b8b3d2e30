"""Lines of values in TOML texts whose lines are known, because the texts are built here."""

from __future__ import annotations

import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocols.documents import line_of

COMMENTS = ("", " # plain", " # a, b, [c], {d = 1}", ' # "quoted', " # it's", "\t# levels = [1,")
SCALARS = (
    "1",
    "-2.5",
    "true",
    '"a"',
    '"a # b, [c]"',
    r'"a \" # ,"',
    "'lit # , ]'",
    "[1, [2, 3], []]",
    '["a,b", "]"]',
    "{ a = 1, b = [2, 3] }",
    "1979-05-27",
)
KEYS = ("alpha", "beta", "gamma", "levels", "my_key")

comments = st.sampled_from(COMMENTS)
scalars = st.sampled_from(SCALARS)
blank = st.lists(comments, max_size=2).map(lambda lines: [text.strip() for text in lines])
Places = dict[tuple[str | int, ...], int]
Text = tuple[list[str], Places]
"""Lines, and the line number of each location."""


@st.composite
def arrays(draw: st.DrawFn, key: str) -> Text:
    """An array over several lines, several entries on some of them."""
    places: Places = {(key,): 1}
    lines = [f"{key} = [" + draw(comments)]
    entries = 0
    for count in draw(st.lists(st.integers(0, 3), max_size=4)):
        row = []
        for _ in range(count):
            places[key, entries] = len(lines) + 1
            entries += 1
            row.append(draw(scalars) + ",")
        lines.append("  " + " ".join(row) + draw(comments))
    return [*lines, "]" + draw(comments)], places


@st.composite
def nested_arrays(draw: st.DrawFn, key: str) -> Text:
    """An array whose entries are themselves arrays over several lines."""
    places: Places = {(key,): 1}
    lines = [f"{key} = ["]
    for entry in range(draw(st.integers(1, 3))):
        places[key, entry] = len(lines) + 1
        inner = draw(st.lists(scalars, max_size=2))
        lines += ["  [" + draw(comments), *(f"    {v}," + draw(comments) for v in inner), "  ],"]
    return [*lines, "]"], places


@st.composite
def single(draw: st.DrawFn, key: str) -> Text:
    written = draw(st.sampled_from([key, f'"{key}"', f"'{key}'", f"  {key}"]))
    return [f"{written} = {draw(scalars)}{draw(comments)}"], {(key,): 1}


def pairs(key: str) -> st.SearchStrategy[Text]:
    return st.one_of(single(key), arrays(key), nested_arrays(key))


@st.composite
def documents(draw: st.DrawFn) -> Text:
    """Keys in any order, blank lines and comments between them, ``[[indicator]]`` tables last."""
    lines: list[str] = []
    places: Places = {}

    def add(part: Text, before: tuple[str | int, ...] = ()) -> None:
        lines.extend(draw(blank))
        places.update({(*before, *at): len(lines) + line for at, line in part[1].items()})
        lines.extend(part[0])

    for key in draw(st.permutations(KEYS))[: draw(st.integers(0, len(KEYS)))]:
        add(draw(pairs(key)))
    for number in range(draw(st.integers(0, 3))):
        lines.extend(draw(blank))
        header = draw(st.sampled_from(["[[indicator]]", "[[ indicator ]]", "  [[indicator]]"]))
        lines.append(header + draw(comments))
        places["indicator", number] = len(lines)
        for key in draw(st.permutations(("port", "axes", "levels")))[: draw(st.integers(0, 3))]:
            add(draw(single(key)), ("indicator", number))
    return lines, places


@given(documents())
def test_every_value_is_found_on_its_line(document: Text) -> None:
    lines, places = document
    text = "\n".join(lines) + "\n"
    tomllib.loads(text)
    assert {place: line_of(text, place) for place in places} == places


@given(documents())
def test_what_is_not_there_has_no_line_or_that_of_its_table(document: Text) -> None:
    lines, places = document
    text = "\n".join(lines)
    assert line_of(text, ("absent",)) is None
    assert line_of(text, ("absent", 3, "port")) is None
    assert line_of(text, ()) is None
    if ("indicator", 0) in places:
        assert line_of(text, ("indicator", 0, "absent")) == places["indicator", 0]


@pytest.mark.parametrize(
    ("text", "location", "line"),
    [
        ("a = [1, 2,\n3]", ("a", 2), 2),
        ("a = [\n\n1,\n\n2\n]", ("a", 1), 5),
        ("a = []\n", ("a", 0), 1),
        ("b = 'a = 1'\na = 2", ("a",), 2),
        ('# a = 1\n"a" = 2', ("a",), 2),
        ("ab = 1\na = 2", ("a",), 2),
        ("a=[1]\r\nb=[\r\n2,\r\n3]\r\n", ("b", 1), 4),
        ("[t]\na = 1\n[[u]]\nb = 1\n[[u]]\nb = 2", ("u", 1, "b"), 6),
        ("[t]\na = 1\n[[u]]\nb = 1\n[[u]]\n\nb = 2", ("u", 0, "b"), 4),
        ("[t]\na = 1", ("t", "a"), 2),
        ("", ("a",), None),
        ('s = """\na = 1\n[[u]]\n\\""" # "\n"""\na = 2', ("a",), 6),
        ("s = '''\na = [\n'''\na = [1,\n2]", ("a", 1), 5),
        ('a = ["""\nx, y]\n""", 2,\n3]', ("a", 1), 3),
        ('a = ["""\nx, y]\n""", 2,\n3]', ("a", 2), 4),
        ('s = \'"""\' # """\na = 1 # \'\'\'\nb = 2', ("b",), 3),
    ],
)
def test_known_texts(text: str, location: tuple[str | int, ...], line: int | None) -> None:
    tomllib.loads(text)
    assert line_of(text, location) == line
