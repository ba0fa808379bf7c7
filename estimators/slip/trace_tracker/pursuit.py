"""State of a tracked trace: confirmed, visible or lost.

A match need not be the trace: the rover's own shadow has two straight edges like the walls of a rut, and moves with the
rover. The lug marks in several images distinguish them; one image is not always enough.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from estimators.slip.trace_tracker.acquisition import Find

MARKED: Final = 0.25  # least correlation of lug marks: edges of shadows reach 0.15, faint marks 0.35
_SURE: Final = 0.33  # mean correlation of marks for confirmation; chance does not reach it in
_IMAGES_TO_CONFIRM: Final = 3  # images
_KEPT: Final = 0.32  # least rut score of a tracked trace over the whole view: faint in shade 0.36, sand 0.25
_KEEPING: Final = 0.8  # weight of the old mean correlation of marks in the update with one image
_IMAGES_TO_LOSE: Final = 5  # consecutive


class Pursuit(NamedTuple):
    """State of a tracked trace."""

    marks: float  # correlation of its lug marks, mean over the last images
    images: int  # images in which it was searched for
    missed: int  # consecutive images in which it was not found
    sure: bool  # True: confirmed by its lug marks

    @property
    def visible(self) -> bool:
        """True if it is confirmed and the last image shows it."""
        return self.sure and self.missed == 0

    @property
    def lost(self) -> bool:
        """True if it was missing for too long."""
        return self.missed >= (_IMAGES_TO_LOSE if self.sure else 1)


def begun(find: Find) -> Pursuit:
    """State of a new trace."""
    return Pursuit(find.marks, images=0, missed=0, sure=False)


def judged(pursuit: Pursuit, score: float, marks: float) -> Pursuit:
    """State after an image with the rut score ``score`` and the correlation ``marks`` of lug marks along the line."""
    marks = _KEEPING * pursuit.marks + (1.0 - _KEEPING) * marks
    images = pursuit.images + 1
    return pursuit._replace(
        marks=marks,
        images=images,
        missed=0 if score > _KEPT and marks > MARKED else pursuit.missed + 1,
        sure=pursuit.sure or (marks > _SURE and images >= _IMAGES_TO_CONFIRM),
    )
