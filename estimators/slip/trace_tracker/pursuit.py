"""A trace that is followed, and whether it is one.

What was found need not be the trace: the rover's own shadow has two straight edges as a rut has two walls, and moves
with the rover as its trace does. One picture does not always tell them apart, the lug marks of several do.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from estimators.slip.trace_tracker.acquisition import Find

MARKED: Final = 0.25  # correlation of lug marks: along edges of shadows 0.15, faint marks 0.35
_SURE: Final = 0.33  # of marks that chance does not make in as many pictures
_PICTURES_TO_BE_SURE: Final = 3
_KEPT: Final = 0.32  # likeness of a trace that is followed over all of the view: faint in shade 0.36, sand 0.25
_KEEPING: Final = 0.8  # share of the mean correlation of marks that one picture more does not change
_PICTURES_TO_LOSE: Final = 5  # running


class Pursuit(NamedTuple):
    """A trace that is followed."""

    marks: float  # correlation of its lug marks, mean over the last pictures
    pictures: int  # in which it was looked for
    missed: int  # of them, running, in which it was not seen
    sure: bool  # whether its marks have been clear once

    @property
    def seen(self) -> bool:
        """Whether the last picture showed it, and it is one."""
        return self.sure and self.missed == 0

    @property
    def lost(self) -> bool:
        """Whether it was not seen for too long."""
        return self.missed >= (_PICTURES_TO_LOSE if self.sure else 1)


def begun(find: Find) -> Pursuit:
    """Of a trace just found."""
    return Pursuit(find.marks, pictures=0, missed=0, sure=False)


def judged(pursuit: Pursuit, score: float, marks: float) -> Pursuit:
    """After a picture that is like a rut by ``score`` along the line, and by ``marks`` as far as those go."""
    marks = _KEEPING * pursuit.marks + (1.0 - _KEEPING) * marks
    pictures = pursuit.pictures + 1
    return pursuit._replace(
        marks=marks,
        pictures=pictures,
        missed=0 if score > _KEPT and marks > MARKED else pursuit.missed + 1,
        sure=pursuit.sure or (marks > _SURE and pictures >= _PICTURES_TO_BE_SURE),
    )
