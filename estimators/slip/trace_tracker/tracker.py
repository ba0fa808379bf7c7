"""Slip from the curved trace behind the wheel, tracked from image to image.

FTrace (Reina 2008) fits a straight line to the edges of one image. This tracker follows the whole rut, its lug marks
and both walls along the wheel's path, which records the slip of the last seconds. The estimated quantities are those of
Reina et al. (2008), "Vision-based estimation of slip angle for mobile robots and planetary rovers"; the method is this
project's own.

A match need not be the trace: the rover's own shadow has two straight edges like the walls of a rut, and moves with the
rover. The lug marks in several images distinguish them; one image is not always enough.
"""

from __future__ import annotations

import math
from typing import ClassVar, Final, NamedTuple, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from estimators.context import RoverContext, wheel_places
from estimators.estimates import Health, SlipAngle, lost_slip
from estimators.slip.rover_odometry import wheel_motion
from estimators.slip.trace_tracker import path_state
from estimators.slip.trace_tracker.path_state import PIECES, SHORTEST, Histories, PathState, moved, with_compass
from estimators.slip.trace_tracker.templates import (
    BAND,
    CHANNELS,
    HALF,
    MARKS,
    SEARCH,
    SIDE,
    STEP,
    Curve,
    FloatImage,
    GroundPatch,
    Profiles,
    Templates,
    at_slips,
    banded,
    channels,
    correlation,
    likely,
    lit,
    place,
    probable,
    rut_score,
    shipped_templates,
    straightened,
    unit,
    unknown_sun,
    weighed,
    windows,
)
from sensors.messages import GreyImage, RoverView
from sensors.sand.trace_rig import TraceRig
from vehicle.clock import TICK
from vehicle.frames import FloatArray

_MATCHED: Final = 0.33  # least correlation of a band that shows the trace
_FARTHEST: Final = 3.5  # largest deviation of the trace [standard deviations], plus
_SPARE: Final = 0.004  # [m]
_LOOKS: Final = 2  # iterations; the second is along the corrected line, where templates fit better
# Measurement error of one band in one image, without that of the sand: peaks jump among lug marks and pebbles. In total
# it is about 1.1 mm at a correlation of 0.9, 1.7 at 0.8, 2.6 at 0.7, over 4 at 0.5 (simulated).
_BAND_NOISE: Final = 0.002  # at a correlation of 0.6 [m]
_BY_CORRELATION: Final = 3  # exponent of its decrease with correlation
# Common error of all bands of one image, from roll, pitch and yaw of the rover on the sand.
_SWAY: Final = 0.0007  # [m]
_TWIST: Final = math.radians(0.05)  # [rad]


class Sight(NamedTuple):
    """Where the trace should lie in the bands of an image, and what it should look like."""

    predictions: list[tuple[FloatArray, FloatArray]]  # of each path, see ``path_state.predicted``
    directions: FloatArray  # (bands,) of the trace in the world [rad]
    under: Profiles  # (AZIMUTHS, shadows, bands, CHANNELS, WIDTH) under all suns
    sunny: Profiles  # (bands, CHANNELS, WIDTH) unit profiles under the likely suns
    shaded: Profiles  # (bands, CHANNELS, WIDTH) unit profiles in shade


class Look(NamedTuple):
    """Matches along the predicted line of the trace in one image."""

    path: Histories  # corrected states
    scores: FloatArray  # (bands,) correlation of the best match
    marks: FloatArray  # (bands,) correlation of the lug marks alone
    accepted: NDArray[np.bool_]  # (bands,) True: the match shows the trace
    sunny: NDArray[np.bool_]  # (bands,) True: more similar to a trace in the sun than in shade
    profiles: Profiles  # (bands, CHANNELS, WIDTH) unit windows at the matches
    sight: Sight

    @property
    def rut_score(self) -> float:
        """Mean rut score of the whole line."""
        return float(rut_score(self.scores, self.marks).mean())


class Ground(NamedTuple):
    """Ground along the expected trace."""

    rig: TraceRig
    line: PathState  # the expected trace
    curve: Curve  # the same on the ground
    image: FloatImage  # (rows, columns, CHANNELS)
    bands: FloatArray  # (bands,) distances behind the wheel [m]


def matched(ground: Ground, path: Histories, templates: Templates, sun: FloatArray) -> Look:
    """Match the trace in an image; ``sun`` is the log likelihood of the sun's direction."""
    slips = path_state.fronts_at(ground.line, ground.rig, ground.bands)
    directions, under = float(ground.line.headings[0]) + ground.curve.directions, at_slips(templates.profiles, slips)
    sunny, shaded = unit(likely(under, sun, directions)), unit(at_slips(templates.shaded, slips))
    predictions = [path_state.predicted(one, ground.rig, ground.bands) for one in path.paths]
    sight = Sight(predictions, directions, under, sunny, shaded)
    look = _match(ground, path, ground.line, sight)
    for _ in range(_LOOKS - 1):
        look = _match(ground, path, look.path.together, sight)
    return look


def _match(ground: Ground, prior: Histories, line: PathState, sight: Sight) -> Look:
    """One step of an iterated Kalman filter from ``prior``, with the measurement taken along ``line``."""
    rig, curve, bands, corrected = ground.rig, ground.curve, ground.bands, prior
    expected, gradient = path_state.predicted(line, rig, bands)
    aside = np.zeros(len(curve.behind))  # of the line, square to the curve [m]
    if line is not ground.line:
        aside = (path_state.trace(line, rig, curve.behind) - curve.lateral) * curve.back
    cut = windows(straightened(ground.image, aside))
    std = np.sqrt(np.sum((gradient @ line.covariance) * gradient, axis=1) + _SWAY**2)
    in_sun, in_shade = correlation(cut, sight.sunny), correlation(cut, sight.shaded)
    off, scores = place(np.maximum(in_sun, in_shade), std)
    positions = banded(curve.lateral) + (banded(aside) + off) / banded(curve.back)
    accepted = (scores > _MATCHED) & (np.abs(positions - expected) < _FARTHEST * std + _SPARE)
    if accepted.any():
        noise = _noise(scores[accepted], bands[accepted])
        corrected = path_state.with_trace(prior, sight.predictions, positions, accepted, noise)
    at = np.rint(off / STEP).astype(int) + SEARCH
    band = np.arange(len(at))
    best, by_sun = cut[band, at], (in_sun.mean(axis=1) > in_shade.mean(axis=1))[band, at]
    marks = np.where(by_sun[:, None], sight.sunny[:, MARKS], sight.shaded[:, MARKS])
    correlations = np.einsum("bw,bw->b", best[:, MARKS], marks)
    return Look(corrected, scores, correlations, accepted, by_sun, best, sight)


def _noise(scores: FloatArray, bands: FloatArray) -> FloatArray:
    """Covariance (n, n) of the measured positions [m2]."""
    own = np.diag((_BAND_NOISE * (0.6 / np.clip(scores, 0.2, 1.0)) ** _BY_CORRELATION) ** 2)
    noise: FloatArray = own + _SWAY**2 + _TWIST**2 * np.outer(bands, bands)
    return noise


_ANGLES: Final = np.radians(np.arange(-18.0, 18.1, 2.0))  # of the wheel's travel without slip to that with slip
_BANDS: Final = 8  # nearest to the wheel, used for the search
_LATERAL: Final = 3  # largest lateral offset of the trace at the wheel [px]
_HALVES: Final = 2  # parts of a band: in each a slanting trace counts as straight
_ROWS: Final = round(BAND / STEP) // _HALVES


class Grip(NamedTuple):
    """Longitudinal slip of the wheels, from how far the marks in the rut have moved from image to image.

    Without it the shape of a bend is not known: the same turn over a longer way lies further aside.
    """

    ratio: float  # slip ratio [-]
    variance: float
    usual: float  # slip ratio, mean over some decimetres [-]
    uneven: float  # mean square of its difference from that, beyond what a turn explains, over the last metres

    def rolled(self, rolled: float, turned: float) -> Grip:
        """After ``rolled`` [m] by the rims and a turn [rad]."""
        keep, usual, uneven = (math.exp(-abs(rolled) / length) for length in (_RATIO_LENGTH, _USUAL, _MEMORY))
        by_turn = _TURNING * _USUAL * turned / max(abs(rolled), 1e-6)
        change = max((self.ratio - self.usual) ** 2 - by_turn**2, 0.0)
        return Grip(
            _RATIO + keep * (self.ratio - _RATIO),
            keep**2 * self.variance + (1.0 - keep**2) * _RATIO_STD**2,
            self.ratio + usual * (self.usual - self.ratio),
            change + uneven * (self.uneven - change),
        )

    def measured(self, ratio: float, std: float) -> Grip:
        """Corrected by a measured slip ratio, unless that is out of the question."""
        innovation, variance = ratio - self.ratio, self.variance + std**2
        if innovation**2 > 16.0 * variance:
            return self
        share = self.variance / variance
        ratio = self.ratio + share * innovation
        usual = ratio if share > 0.5 else self.usual  # the first one tells of no change
        return self._replace(ratio=ratio, variance=(1.0 - share) * self.variance, usual=usual)


# Light rovers on level dry sand have 0.05 to 0.15, uphill more, downhill less; assumed.
_RATIO: Final = 0.1  # mean [-]
_RATIO_STD: Final = 0.07
_RATIO_LENGTH: Final = 3.0  # correlation length, by the slopes of the ground, assumed [m]
_USUAL: Final = 0.5  # [m]
_MEMORY: Final = 1.5  # [m]
_TURNING: Final = 0.1  # change of slip ratio by a turn on a plane slope of 6 deg [1/rad]
_RUT: Final = 12  # half of the width that shows the ground of the rut [px]
_LONGEST: Final = 0.04  # way between images beyond which one lug mark is mistaken for the next [m]
_REACH: Final = 0.35  # largest difference of the way from the expected one, as a share
_ALIKE: Final = 0.3  # least correlation of the same ground in two images
_SHIFT_NOISE: Final = 0.0004  # of a way between two images [m]


def shift(before: FloatImage, now: FloatImage, expected: float) -> float | None:
    """Way of the ground backwards between two images of the rut (rows, columns) [m]; None if it can not be seen."""
    middle, reach = expected / STEP, math.ceil(_REACH * expected / STEP) + 1
    first = max(round(middle) - reach, 0)
    rows = len(before) - first - 2 * reach
    seen = cv2.matchTemplate(now[first : first + rows + 2 * reach], before[:rows], cv2.TM_CCOEFF_NORMED)[:, 0]
    best = int(seen.argmax())
    if not 0 < best < len(seen) - 1 or seen[best] < _ALIKE:
        return None
    left, top, right = (float(score) for score in seen[best - 1 : best + 2])
    return STEP * (first + best + 0.5 * (left - right) / min(left - 2.0 * top + right, -1e-9))


def way_of_centre(rig: TraceRig, way: float, yaw: float, slip: float) -> float:
    """Way of R's origin [m] from that of the wheel [m], the turn [rad] and the slip angle of the centre [rad]."""
    x, y = rig.wheel
    aside = yaw * (x * math.sin(slip) - y * math.cos(slip))
    return math.sqrt(max(aside**2 - yaw**2 * (x**2 + y**2) + way**2, 0.0)) - aside


class Find(NamedTuple):
    """Best straight trace in an image."""

    slip: float  # angle of the wheel's travel to the image's columns [rad]
    score: float  # see ``matching.rut_score``
    marks: float  # correlation of the lug marks alone


def best_straight(image: FloatImage, behind: FloatArray, profiles: Profiles, front: float = 0.0) -> Find:
    """Straight line through the wheel with the best rut score, over the template ``profiles`` (n, slips, ...).

    ``front`` is the front wheel's rut without slip, see ``path_state.with_fronts`` [rad].
    """
    windows_at = np.moveaxis(_slanting(image, behind), 2, 1)  # (angles, CHANNELS, shifts, WIDTH)
    templates = unit(at_slips(profiles, front + _ANGLES)).transpose(1, 2, 3, 0)  # (angles, CHANNELS, WIDTH, n)
    each = windows_at @ templates
    marks = each[:, MARKS]
    scores = rut_score(each.mean(axis=1), marks)
    best = np.unravel_index(scores.argmax(), scores.shape)
    return Find(float(_ANGLES[best[0]]), float(scores[best]), float(marks[best]))


def _slanting(image: FloatImage, behind: FloatArray) -> Profiles:
    """Mean unit windows (angles, shifts, CHANNELS, WIDTH) of the bands along straight lines from the wheel."""
    rows = _BANDS * _HALVES * _ROWS
    halves = image[:rows].reshape(-1, _ROWS, *image.shape[1:]).mean(axis=1)
    at = behind[:rows].reshape(-1, _ROWS).mean(axis=1)
    reach = np.arange(-HALF - _LATERAL, HALF + _LATERAL + 1)
    middle = np.rint(-np.tan(_ANGLES)[:, None] * at / STEP).astype(int) + image.shape[1] // 2
    columns = np.clip(middle[..., None] + reach, 0, image.shape[1] - 1)
    slanting = halves[np.arange(len(at))[None, :, None], columns]  # (angles, halves, reach, CHANNELS)
    profiles = slanting.reshape(len(_ANGLES), -1, _HALVES, len(reach), CHANNELS).mean(axis=2).transpose(0, 1, 3, 2)
    mean: Profiles = windows(profiles).mean(axis=1)
    return mean


_LAG: Final = 2.0  # of the delayed, more accurate estimate [s]
# Ratio of the errors to the filter's standard deviation, which allows for fast slip changes and shadows at any time.
_OF_FILTER: Final = 0.75
# Ground 1 cm above or below the wheels' plane seems to move by so much more or less. A way that is wrong by a share
# shifts the trace of a bend like a slip of that share of its turn from the wheel to the middle of the view.
_UNEVEN: Final = 0.015
_MIDDLE: Final = 0.36  # [m]
# Slip ratio changes by 1.0 per radian of pitch, slip angle by 0.9 per radian of roll (rovers on sand). Ground that is
# uneven along the way, as slip ratios show, is so across it. A change of slip is known some 0.25 m later.
_BY_UNEVENNESS: Final = 0.9 / 1.0 * 0.25 / _USUAL  # [rad]
_CERTAIN: Final = (0.3, 0.7)  # rut score of sand without a trace, and of clear traces


def slip_angle(rig: TraceRig, histories: Histories, grip: Grip, steer: float, tick: int, score: float) -> SlipAngle:
    """Slip angle message for a trace with the rut score ``score`` behind a wheel at the angle ``steer`` [rad]."""
    path = histories.together
    before = path.ticks <= tick - _LAG / TICK
    piece = int(np.argmax(before))
    known = bool(before[piece])
    slip, variance = path_state.slip_at(path, 0)
    lagged, lagged_variance = path_state.slip_at(path, piece)
    value, rate = slip + path.steered, path_state.bend(path, 0)
    added = (rate * _MIDDLE) ** 2 * (grip.variance + _UNEVEN**2) + _BY_UNEVENNESS**2 * grip.uneven
    return SlipAngle(
        tick=tick,
        value=value,
        std=math.sqrt(_OF_FILTER**2 * variance + added),
        health=Health.OK,
        wheel_slip=wheel_direction(rig, value, rate) - steer,
        trace_offset=path.offset,
        confidence=float(np.interp(score, _CERTAIN, (0.0, 1.0))),
        lagged_tick=int(path.ticks[piece]) if known else None,
        lagged_value=lagged + float(path.steer[[max(piece - 1, 0), piece]].mean()) if known else 0.0,
        lagged_std=math.sqrt(_OF_FILTER**2 * lagged_variance + added) if known else math.inf,
    )


def wheel_direction(rig: TraceRig, slip: float, rate: float) -> float:
    """Direction of the wheel's travel relative to the body [rad], from the slip angle at R's origin [rad] (eq. 2).

    ``rate`` is the yaw change per distance of the centre [rad/m].
    """
    x, y = rig.wheel
    return math.atan2(math.sin(slip) + rate * x, math.cos(slip) - rate * y)


_MARKED: Final = 0.25  # least correlation of lug marks: edges of shadows reach 0.15, faint marks 0.35
_SURE: Final = 0.33  # mean correlation of marks for confirmation; chance does not reach it in
_IMAGES_TO_CONFIRM: Final = 3  # images
_KEPT: Final = 0.32  # least rut score of a tracked trace over the whole view: faint in shade 0.36, sand 0.25
_KEEPING: Final = 0.8  # weight of the old mean correlation of marks in the update with one image
_IMAGES_TO_LOSE: Final = 5  # consecutive
_FOUND: Final = 0.36  # least score of a new trace: sand under moving shadows reaches it once in a hundred images
_IMAGES_TO_FIND: Final = 2  # consecutive
_PIECE: Final = 0.018  # usual length of a piece by the wheels' rims [m]
_FOUND_STD: Final = math.radians(4.0)  # of the slip of a new trace


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


class TraceMemory(NamedTuple):
    """State of the tracker after a view."""

    tick: int | None  # of the last view
    unused: float  # distance since the start of the newest piece, by the wheels' rims [m]
    turned: float  # yaw over that distance, by the encoders [rad]
    seconds: float  # duration of that distance [s]
    grip: Grip
    rut: FloatImage | None  # (rows, columns) brightness of the rut in the last image; None: no trace was tracked
    path: Histories | None
    pursuit: Pursuit | None  # state of tracking; None: no trace is tracked
    hints: int  # consecutive images that show a trace
    sun: FloatArray  # (AZIMUTHS, shadows) log likelihood of the sun's azimuth in the world, and of its shadows
    estimate: SlipAngle | None  # the last one


class FTracePlus:
    """Tracker of the left rear wheel's trace; ``init`` and ``step`` are pure."""

    sensor: ClassVar[str] = "trace_camera"

    def __init__(self, rig: TraceRig, templates: Templates | None = None) -> None:
        self._rig = rig
        self._patch = GroundPatch(rig=rig)
        self._wheels = wheel_places(rig.wheels)
        self._templates = shipped_templates() if templates is None else templates

    @classmethod
    def of(cls, context: RoverContext) -> Self:
        """Estimator for the context's camera."""
        return cls(context.rig)

    def init(self) -> TraceMemory:
        """Before the first view."""
        return TraceMemory(
            None, 0.0, 0.0, 0.0, Grip(_RATIO, _RATIO_STD**2, _RATIO, 0.0), None, None, None, 0, unknown_sun(), None
        )

    def step(self, memory: TraceMemory, view: RoverView) -> tuple[TraceMemory, SlipAngle]:
        """Memory and slip angle; the last estimate is repeated until the rover has moved by a piece."""
        memory = self._wheel_motion(memory, view)
        if memory.estimate is not None and 0.0 <= memory.unused < SHORTEST:
            return memory, memory.estimate
        path = self._path(memory, view)
        moved_by, memory = memory, memory._replace(unused=0.0, turned=0.0, seconds=0.0)
        if memory.pursuit is None:
            memory, path = self._searched(memory, path, view.image)
        estimate, pursuit = lost_slip(view.tick), memory.pursuit
        if pursuit is not None:
            ground = self._ground(path.together, view.image, SIDE)
            memory = self._gripped(memory, moved_by, ground)
            look = matched(ground, path, self._templates, memory.sun)
            path, pursuit = look.path, judged(pursuit, look.rut_score, float(look.marks.mean()))
            if pursuit.visible:
                use, sight = look.accepted & look.sunny, look.sight
                if use.any():
                    sun = weighed(memory.sun, sight.under[:, :, use], look.profiles[use], sight.directions[use])
                    memory = memory._replace(sun=sun)
                steer = float(view.steer[self._rig.watched])
                estimate = slip_angle(self._rig, path, memory.grip, steer, view.tick, look.rut_score)
            if pursuit.lost:
                pursuit, memory = None, memory._replace(rut=None)
        path = path.each(lambda one: path_state.with_fronts(one, self._rig))
        return memory._replace(path=path, pursuit=pursuit, estimate=estimate), estimate

    def _wheel_motion(self, memory: TraceMemory, view: RoverView) -> TraceMemory:
        """Memory with the encoders' motion since the last view; a rover that reverses over its trace restarts."""
        if memory.tick is None:
            return memory._replace(tick=view.tick)
        seconds = (view.tick - memory.tick) * TICK
        length = seconds * self._rig.wheel_radius * float(view.wheel_speeds.mean())
        rolling = wheel_motion(self._wheels, self._rig.wheel_radius * view.wheel_speeds, view.steer)  # without slip
        if memory.unused + length < -SHORTEST:
            return self.init()._replace(tick=view.tick, sun=memory.sun)
        return memory._replace(
            tick=view.tick,
            unused=memory.unused + length,
            grip=memory.grip.rolled(length, seconds * rolling.yaw_rate),
            turned=memory.turned + seconds * rolling.yaw_rate,
            seconds=memory.seconds + seconds,
        )

    def _gripped(self, memory: TraceMemory, before: TraceMemory, ground: Ground) -> TraceMemory:
        """Memory with the longitudinal slip since the last image, which ended at ``before``."""
        rolled, rut = before.unused, np.ascontiguousarray(ground.image[:, SIDE - _RUT : SIDE + _RUT + 1, 0])
        if before.rut is None or not 0.0 < rolled < _LONGEST:
            return memory._replace(rut=rut)
        yaw, slip = (1.0 - before.grip.ratio) * before.turned, float(ground.line.body_slips[0])
        expected = (1.0 - before.grip.ratio) * rolled - self._rig.wheel[1] * yaw
        way = shift(before.rut, rut, max(expected, 0.0))
        if way is None:
            return memory._replace(rut=rut)
        ratio = 1.0 - way_of_centre(self._rig, way, yaw, slip) / rolled
        return memory._replace(rut=rut, grip=memory.grip.measured(ratio, _SHIFT_NOISE / rolled))

    def _ground(self, line: PathState, image: GreyImage, half: int) -> Ground:
        """Ground along the line of the trace, ``half`` pixels to either side."""
        curve = Curve.through(self._patch.behind, path_state.trace(line, self._rig, self._patch.behind))
        along = channels(self._patch.along(curve, image, half))
        return Ground(self._rig, line, curve, along, banded(curve.behind))

    def _searched(self, memory: TraceMemory, path: Histories, image: GreyImage) -> tuple[TraceMemory, Histories]:
        """Memory and path after a search for a new trace, which slants to that of a rover without slip."""
        line = path_state.with_slip(path.together, 0.0, _FOUND_STD)
        ground = self._ground(line, image, self._patch.columns // 2)
        direction = float(line.headings[0] + ground.curve.directions[:_BANDS].mean())
        profiles = lit(self._templates.profiles, direction)[probable(memory.sun)]
        front = float(path_state.fronts_at(line, self._rig, ground.bands[:_BANDS]).mean())
        behind = self._patch.behind[0] + STEP * np.arange(len(ground.image))  # along the curve
        find = best_straight(ground.image, behind, np.concatenate([profiles, self._templates.shaded[None]]), front)
        hints = memory.hints + 1 if find.score > _FOUND and find.marks > _MARKED else 0
        if hints < _IMAGES_TO_FIND:
            return memory._replace(hints=hints), path
        return memory._replace(hints=0, pursuit=begun(find)), path_state.with_new_trace(path, find.slip, _FOUND_STD)

    def _path(self, memory: TraceMemory, view: RoverView) -> Histories:
        """Path states up to the view, by encoders and compass."""
        steer = math.atan(float(np.tan(view.steer).mean()))  # direction of the centre's travel without sideslip [rad]
        if memory.path is None:
            return path_state.begun_histories(view.heading, steer, view.tick, len(self._patch.bands))
        share = (1.0 - memory.grip.ratio) / (pieces := min(max(round(memory.unused / _PIECE), 1), PIECES))
        distance, yaw, seconds = share * memory.unused, share * memory.turned, memory.seconds / pieces

        def onward(path: PathState) -> PathState:
            """Path after the way since the last image, on which slip may have changed."""
            for left in reversed(range(pieces)):
                path = moved(path, distance, yaw, seconds, steer, view.tick - round(left * seconds / TICK))
            return with_compass(path, view.heading)

        return memory.path.each(onward)


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
        missed=0 if score > _KEPT and marks > _MARKED else pursuit.missed + 1,
        sure=pursuit.sure or (marks > _SURE and images >= _IMAGES_TO_CONFIRM),
    )
