"""Widgets that are not drawn again while nothing changes.

Textual asks every widget of a screen for every picture of any of them, and to ask one that did not
change takes as long as to draw a row.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Self

from textual.color import TRANSPARENT
from textual.geometry import Offset, Region
from textual.strip import Strip
from textual.widget import Widget

MOST_ROWS_KEPT = 96
"""A last digit that flickers comes back to the same few rows."""


class CachedLines(Widget):
    """Keeps its rows as drawn, with border and colours, until something changes."""

    _whole: Region | None = None
    _strips: list[Strip]

    def render_lines(self, crop: Region) -> list[Strip]:
        """The rows of before where nothing changed."""
        whole = self.outer_size.region
        if whole != self._whole:
            self._strips, self._whole = self.draw_all(whole), whole
        if crop == whole:
            return self._strips
        kept = self._strips[crop.y : crop.bottom]
        return [strip.crop(crop.x, crop.right) for strip in kept]

    def draw_all(self, whole: Region) -> list[Strip]:
        """Every row."""
        return super().render_lines(whole)

    def refresh(
        self,
        *regions: Region,
        repaint: bool = True,
        layout: bool = False,
        recompose: bool = False,
    ) -> Self:
        """Draw everything again."""
        self._whole = None
        return super().refresh(*regions, repaint=repaint, layout=layout, recompose=recompose)

    def notify_style_update(self) -> None:
        """Other colours or another border: nothing that was drawn holds."""
        self._whole = None
        super().notify_style_update()


class CachedRows(CachedLines):
    """Draws single rows again, by `render_line`, between what stands left and right of them."""

    _stale: frozenset[int] = frozenset()
    _edges: Sequence[tuple[Strip, Strip]]
    _place = Offset()
    _rows_before: dict[tuple[int, Hashable], Strip]

    def row_key(self, y: int) -> Hashable:
        """What a row of the content shows; rows of equal keys are drawn once. None: every time."""
        return None

    def render_lines(self, crop: Region) -> list[Strip]:
        """The rows of before but for those that `draw_rows` named."""
        if self._stale and self._whole is not None:
            self._renew(self._strips)
        return super().render_lines(crop)

    def draw_all(self, whole: Region) -> list[Strip]:
        """Every row; what Textual kept of the content may be older than ours."""
        strips = super().draw_all(whole)
        if isinstance(self.parent, Widget):
            self._place = self.content_region.offset - self.parent.content_region.offset
        left, top, (width, height) = self.gutter.left, self.gutter.top, self.size
        rows = strips[top : top + height]
        self._edges = [(row.crop(0, left), row.crop(left + width)) for row in rows]
        self._stale, self._rows_before = frozenset(range(height)), {}
        self._renew(strips)
        return strips

    def draw_rows(self, first: int, rows: int) -> None:
        """Draw rows of the content again.

        The parent tells the screen, once for all of its children; what is its own stays as it is.
        """
        self._stale = self._stale.union(range(first, first + rows))
        parent = self.parent
        if isinstance(parent, Widget):
            place = self._place
            Widget.refresh(parent, Region(place.x, place.y + first, self.size.width, rows))

    def _renew(self, strips: list[Strip]) -> None:
        before = self._rows_before
        if len(before) > MOST_ROWS_KEPT:
            before.clear()
        for y in self._stale:
            key = self.row_key(y)
            strip = before.get((y, key)) or self._drawn(y)
            strips[self.gutter.top + y] = strip
            if key is not None:
                before[y, key] = strip
        self._stale = frozenset()

    def _drawn(self, y: int) -> Strip:
        """One whole row, in the colours of the terminal."""
        width, ground = self.size.width, self.visual_style
        content = self.render_line(y).adjust_cell_length(width, ground.rich_style)
        left, right = self._edges[y]
        strip = Strip([*left, *content, *right], self.outer_size.width)
        for line_filter in self.get_line_filters():
            strip = strip.apply_filter(line_filter, ground.background or TRANSPARENT)
        return strip
