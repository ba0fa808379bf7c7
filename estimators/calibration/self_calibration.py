"""Online self-calibration: an odometry that estimates the right camera's rotation and delay.

A mount bent by a tenth of a degree biases the off-tracking by decimetres (de Saxe 2018, section 4.3); a right camera
that exposes 10 ms late does so at 20 km/h. Both are estimated continuously: from the rows of every single pair, and yaw
from pairs some metres apart. The right image is corrected before the odometry: by a homography for rotations (eqs 8 and
9), point by point for the distance travelled over the delay (``estimators.stereo_pair``). A pair that contradicts
the estimate is lost; if the next one does too, mount or clock have changed, and the estimate starts anew from it. If
then two pairs are as before, and no motions have proven the new estimate yet, it was a passing disturbance.

Without correction (``correcting=False``) rotations are only watched: motions of a pair whose calibration is refuted are
degraded, with the error in their covariance, or lost. The delay is compensated in any case.

Not modelled: rotation of the left camera (to first order equivalent), translation of the cameras, and the part of a
delay's displacement that is along the baseline while the velocity along the optical axis is too small to show it.

de Saxe 2018: C. de Saxe, D. Cebon, "Estimation of trailer off-tracking using visual odometry", Vehicle System
Dynamics, 2018.

A yaw error that makes disparities too large moves far scenery near. At high speed it is then the only part of the view
that is found again, and it agrees with no motion at all.
"""

from typing import Generic, NamedTuple

import numpy as np

from estimators.calibration.corrections import (
    NONE,
    Corrections,
    SelfCalibratedMotion,
    corrected,
    doubt,
    is_another,
    of_delay,
    of_rotation,
    with_calibration,
)
from estimators.calibration.epipolar import EpipolarFit, epipolar_fit, fitted_to_rays, homography, moved
from estimators.calibration.mount_state import (
    DELAY,
    UNKNOWN,
    YAW,
    MountState,
    PairGeometry,
    Twist,
    carried,
    expected_fit,
    geometry,
    initial,
    innovation,
    is_expected,
    is_surprising,
    reopened,
    with_fit,
    with_information,
)
from estimators.calibration.rotation_fit import FEWEST, View, from_motion, new_view, rematched
from estimators.context import Memory, Odometry
from estimators.estimates import Health, Motion, lost_motion
from estimators.odometry.circular import CircularOdometry
from estimators.odometry.exposure import clipped_share, match_clipping
from estimators.odometry.image_points import LEVELS_NEAR, detect_corners, rays_through, track
from estimators.odometry.keyframe import KeyframeOdometry
from estimators.rigid_motion import chained, rotation_vector
from estimators.stereo_pair import project
from sensors.camera.rig import StereoCalibration
from sensors.messages import GreyImage, StereoFrame
from vehicle.clock import TICK
from vehicle.frames import FloatArray, so3_exp

# Distances from the reference view at which yaw is measured: the first one, and then the double of the last. An early
# coarse value is better than a late fine one, but errors of lenses matter less from afar [m].
_FIRST_LOOK, _FIRST_LOOK_IN_DOUBT = 4.0, 0.9
_DOUBT = np.radians(0.01)  # of yaw, 1 sigma: more counts as uncertain and costs 6 mm of off-tracking [rad]
_APART = 10.0  # distance beyond which a new reference view is taken: views share too few points [m]
_REST = 5.0  # distance from a reference view that a turn took out of sight to the next, while yaw is known [m]
_TURNED = np.radians(15.0)  # rotation between two views at which yaw is measured: beyond it they share few points
_SHIFTED = 0.015  # displacement of the right camera that is beyond errors of lenses [m]
_SHIFTED_SHARE = 0.05  # the same, as a share of the displacement that is compensated
_PROVEN = 5.0  # distance of motions after which a new estimate is no passing disturbance [m]
_SIGNIFICANT = 8.0  # the same in standard deviations of a fit, which are half of the real ones


class Taken(NamedTuple):
    """A frame before corrections, and the velocity before it."""

    frame: StereoFrame
    twist: Twist
    lost: bool = False  # True if no motion ended at it
    left_over: float = 0.0  # displacement of its right image that was not compensated [m]


class Earlier(NamedTuple):
    """Estimate from before pairs contradicted it, kept until motions have proven the new one."""

    state: MountState
    agreed: bool = False  # True if the newest pair is as before
    proven: float = 0.0  # distance of motions with the new one [m]

    def after(self, distance: float) -> "Earlier | None":
        """The earlier estimate after a motion of some distance [m]; None once the new one is proven."""
        proven = self.proven + distance
        return self._replace(proven=proven) if proven < _PROVEN else None


class SelfCalibrationMemory(NamedTuple, Generic[Memory]):
    """Memory of the odometry, the estimate, and the reference view."""

    odometry: Memory
    state: MountState
    applied: Corrections = NONE
    twist: Twist = UNKNOWN  # by the last motion
    fresh: float | None = None  # distance since the last fit to a single pair [m]; None: there is none
    previous: tuple[Taken, ...] = ()  # newest frames of the odometry, oldest first
    suspect: StereoFrame | None = None  # newest frame, if it contradicts the estimate
    earlier: Earlier | None = None  # estimate to which a passing disturbance returns
    shift: float = 0.0  # displacement of the right camera along the optical axis, by the newest frame [m]
    assumed: float = 0.0  # the same for the first motion, as long as no velocity relates it to a delay [m]
    view: View | None = None
    X_VC: FloatArray = np.eye(4)  # of the newest frame in the view
    look: float = 0.0  # distance from the view at which yaw is measured next [m]
    clipped: float = 0.0  # share of clipped pixels in the images of late
    rest: float = 0.0  # distance from the last view before which none is needed, unless yaw is in doubt [m]


def pair_geometry(memory: SelfCalibrationMemory[Memory], baseline: float) -> PairGeometry:
    """Geometry of the corrected pairs; before the first motion, a displacement along the optical axis at most."""
    if memory.assumed:
        return PairGeometry(np.eye(3), np.array([0.0, 0.0, memory.assumed]))
    return geometry(memory.applied.delay, memory.twist, baseline)


def left_over(memory: SelfCalibrationMemory[Memory], baseline: float) -> float:
    """Displacement [m] of the newest right camera that is not compensated; 0 if it is not significant."""
    applied = pair_geometry(memory, baseline).shift
    compensated = 0.0 if applied is None else float(applied[2])
    remaining = abs(memory.shift - compensated) if memory.shift else 0.0
    return remaining if remaining > max(_SHIFTED, _SHIFTED_SHARE * abs(compensated)) else 0.0


def significant_shift(fit: EpipolarFit) -> float:
    """Displacement [m] of the right camera along the optical axis by a single pair; 0 if it is not significant."""
    shift = float(fit.values[3])
    return shift if abs(shift) > max(_SHIFTED, _SIGNIFICANT * float(np.sqrt(fit.covariance[3, 3]))) else 0.0


def look_due(memory: SelfCalibrationMemory[Memory]) -> bool:
    """True if the newest frame is far enough from the reference view, or nearly too far rotated."""
    if memory.view is None:
        return False
    return _shift(memory) > memory.look or _is_turned(memory)


def looked(memory: SelfCalibrationMemory[Memory]) -> SelfCalibrationMemory[Memory]:
    """Memory after a look at yaw; a view is looked at once after a turn, since later frames share too few points."""
    if _is_turned(memory):
        return memory._replace(view=None, rest=_REST)
    return memory._replace(look=2.0 * _shift(memory))


def view_due(memory: SelfCalibrationMemory[Memory]) -> bool:
    """True if the newest frame becomes the reference view."""
    if memory.view is None:
        return _in_doubt(memory.state) or _shift(memory) >= memory.rest
    return memory.look > _APART


def _shift(memory: SelfCalibrationMemory[Memory]) -> float:
    """Distance of the newest frame from the view [m]."""
    return float(np.linalg.norm(memory.X_VC[:3, 3]))


def _is_turned(memory: SelfCalibrationMemory[Memory]) -> bool:
    turn = np.linalg.norm(rotation_vector(memory.X_VC[:3, :3]))
    return bool(turn > _TURNED and _shift(memory) > _FIRST_LOOK_IN_DOUBT)


def _in_doubt(state: MountState) -> bool:
    return bool(state.covariance[YAW, YAW] > _DOUBT**2)


STANDING = 0.1  # motions of a camera that takes a vehicle close behind for the world are shorter [m]
_AS_STATED = 3.0  # largest error of a corner on the ground after the right motion [px]
_NEAR = 0.12  # slope of a ray to the ground, downwards: nearer than some eight camera heights
_FEWEST = 20  # corners on the ground
_SHARE = 0.5  # of them, that move by the motion
_PER_BUCKET = 2


def ground_contradicts(calibration: StereoCalibration, before: GreyImage, now: GreyImage, X_PC: FloatArray) -> bool:
    """True if most of the ground in two successive left images has not moved by X_PC; False if that cannot be seen."""
    corners = detect_corners(before, per_bucket=_PER_BUCKET)
    rays = rays_through(calibration, corners)
    down = -rays @ calibration.X_SC[2, :3]
    near = down > _NEAR
    if np.count_nonzero(near) < _FEWEST:
        return False
    points = rays[near] * (calibration.X_SC[2, 3] / down[near])[:, None]
    expected = project(calibration, (points - X_PC[:3, 3]) @ X_PC[:3, :3])[:, :2].astype(np.float32)
    found, tracked = track(before, now, corners[near], expected, LEVELS_NEAR)
    agrees = tracked & (np.abs(found - expected).max(axis=1) < _AS_STATED)
    return bool(np.count_nonzero(agrees) < _SHARE * len(points))


_REMATCHED = 3  # rounds of matching and fitting, each from the result of the one before
_SETTLED = 1.0  # change of the angles after which no more round is needed [standard deviations]
_SCATTERED = 0.4  # scatter of the rows of an odometry's matches beyond which the pair is looked at anew [px]
_ASSUMED = 0.15  # relative error of a velocity with the displacement along the optical axis alone compensated, 1 sigma
_CLIPPED = 0.05  # share of the pixels above which images count as clipped
_FADING = 0.97  # of that share, from frame to frame: automatic exposure clips some frames and others not
_LONGEST_LOSS = 500  # older frames are not returned to for a restart [ticks]


class SelfCalibratedOdometry(Generic[Memory]):
    """Odometry on corrected images, with self-calibration around it."""

    def __init__(
        self, calibration: StereoCalibration, odometry: Odometry[Memory], *, seed: int = 0, correcting: bool = True
    ) -> None:
        """Self-calibration around an odometry; ``seed`` and a frame's tick fix all random draws.

        With ``correcting=False`` rotations of the right camera are watched, not corrected. Odometries that do not know
        displaced pairs (``estimators.stereo_pair``) are lost or degraded while the right camera exposes late.
        """
        self._calibration, self._odometry, self._seed, self._correcting = calibration, odometry, seed, correcting
        self._compensating = isinstance(odometry, CircularOdometry | KeyframeOdometry)

    def init(self) -> SelfCalibrationMemory[Memory]:
        """Memory before the first frame."""
        return SelfCalibrationMemory(self._odometry.init(), initial())

    def step(
        self, memory: SelfCalibrationMemory[Memory], frame: StereoFrame
    ) -> tuple[SelfCalibrationMemory[Memory], SelfCalibratedMotion | None]:
        """Memory with the frame in it, and the motion that ends at it; None for the first frame.

        The motion of a frame that contradicts the estimate is lost, and the frame is skipped.
        """
        memory = self._with_clipping(memory, frame)
        tried = self._restarted(memory, False)
        stepped = self._stepped(tried, frame)
        newly = tried.odometry is not memory.odometry  # then the restart is repeated, with the rows of this frame
        memory, changed = self._with_rows(tried, frame, stepped[1])
        if memory.suspect is frame:
            return memory, self._message(lost_motion(frame.tick, memory.previous[-1].frame.tick), memory)
        start = self._restarted(memory, changed or newly)
        if start.odometry is tried.odometry and start.assumed == tried.assumed:
            after, motion = self._with_motion(start._replace(applied=tried.applied), frame, stepped)
        else:
            after, motion = self._with_motion(start, frame, self._stepped(start, frame))
        if motion is not None and motion.health is Health.LOST and start.applied.rotation != memory.state.rotation:
            again = self._restarted(start, changed, at_once=True)
            if again.applied != start.applied:  # the best guess of the rotation may be what the odometry needs
                after, motion = self._with_motion(again, frame, self._stepped(again, frame))
        if motion is None:
            return self._with_view(after, frame), None
        if motion.health is not Health.LOST and look_due(after):
            after = self._with_yaw(after, frame)
            again = self._restarted(start._replace(state=after.state), False)
            if is_another(again.applied, start.applied):  # the motion once more, with the better correction
                before = after
                after, motion = self._with_motion(again, frame, self._stepped(again, frame))
                if motion is not None and motion.health is not Health.LOST:
                    after = after._replace(view=before.view, X_VC=before.X_VC, look=before.look, rest=before.rest)
        if motion is None or after.assumed:
            motion = lost_motion(frame.tick, memory.previous[-1].frame.tick)
        if view_due(after):
            after = self._with_view(after, frame)
        return after._replace(assumed=0.0), self._message(motion, after)

    def _with_clipping(
        self, memory: SelfCalibrationMemory[Memory], frame: StereoFrame
    ) -> SelfCalibrationMemory[Memory]:
        """Memory with the share of clipped pixels; a view from before the first clipped frame has too few points."""
        clipped = max(clipped_share(frame.left), clipped_share(frame.right), _FADING * memory.clipped)
        begins = clipped > _CLIPPED >= memory.clipped
        return memory._replace(clipped=clipped, view=None if begins else memory.view)

    def _with_rows(
        self, memory: SelfCalibrationMemory[Memory], frame: StereoFrame, motion: Motion | None
    ) -> tuple[SelfCalibrationMemory[Memory], bool]:
        """Memory with the rows of a frame in its estimate; True if the odometry must restart before it.

        The rows of a motion's own matches are enough as long as they are as expected. A frame that contradicts the
        estimate becomes the suspect; after a second one the estimate starts anew there.
        """
        baseline, changed = self._calibration.baseline, False
        fit = self._expected_rows(memory, motion) or self._fit(memory.state, memory.twist, frame)
        if memory.earlier is not None:  # from a wrong new estimate, sound pairs may have no fit at all
            memory, as_before = self._returned(memory, memory.earlier, frame)
            fit, changed = as_before or fit, as_before is not None
        if fit is None:
            return memory._replace(suspect=None, shift=0.0), False
        innovated = innovation(memory.state, fit, memory.twist, baseline)
        if memory.previous and is_surprising(memory.state, innovated):
            if memory.suspect is None:
                return memory._replace(suspect=frame), False
            suspect = Taken(memory.suspect, memory.twist)
            earlier = memory.earlier or Earlier(memory.state)
            memory = memory._replace(
                state=reopened(memory.state), earlier=earlier, fresh=None, view=None, previous=(suspect,)
            )
            innovated, changed = innovation(memory.state, fit, memory.twist, baseline), True
        state, shift = with_fit(memory.state, innovated, memory.fresh), significant_shift(fit)
        memory = memory._replace(state=state, fresh=0.0, suspect=None, shift=shift)
        if shift and not memory.twist.known and self._compensating:
            memory, changed = memory._replace(assumed=shift), True
        return memory, changed

    def _returned(
        self, memory: SelfCalibrationMemory[Memory], earlier: Earlier, frame: StereoFrame
    ) -> tuple[SelfCalibrationMemory[Memory], EpipolarFit | None]:
        """Memory with the earlier estimate, restarted at the first of two pairs that are as before; the second's fit.

        As long as there are not two, the earlier estimate is only kept, and the fit is None.
        """
        fit, baseline = self._fit(earlier.state, memory.twist, frame), self._calibration.baseline
        agreed = fit is not None and is_expected(earlier.state, innovation(earlier.state, fit, memory.twist, baseline))
        if not (agreed and earlier.agreed):
            return memory._replace(earlier=earlier._replace(agreed=agreed)), None
        first = memory.previous[-1:] if memory.suspect is None else (Taken(memory.suspect, memory.twist),)
        return memory._replace(state=earlier.state, earlier=None, fresh=None, view=None, previous=first), fit

    def _expected_rows(self, memory: SelfCalibrationMemory[Memory], motion: Motion | None) -> EpipolarFit | None:
        """Fit to the points that the odometry has matched in a pair; None without any, or if it is not as expected."""
        if motion is None or motion.pairs is None or motion.health is Health.LOST or memory.suspect or memory.earlier:
            return None
        attitude = pair_geometry(memory, self._calibration.baseline).attitude(memory.applied.rotation)
        raw = moved(homography(self._calibration, attitude.T), motion.pairs[:, 2:])
        r, q = (rays_through(self._calibration, points)[:, :2] for points in (motion.pairs[:, :2], raw))
        fit = fitted_to_rays(self._calibration, r, q, *self._expected(memory.state, memory.twist))
        if fit is None or fit.scatter > _SCATTERED or significant_shift(fit):
            return None
        innovated = innovation(memory.state, fit, memory.twist, self._calibration.baseline)
        return None if is_surprising(memory.state, innovated) else fit

    def _fit(self, state: MountState, twist: Twist, frame: StereoFrame) -> EpipolarFit | None:
        """Fit to the single pair, from what is expected of it."""
        return epipolar_fit(self._calibration, frame, *self._expected(state, twist))

    def _expected(self, state: MountState, twist: Twist) -> tuple[FloatArray, FloatArray]:
        """Values (4,) that a fit to a single pair should have, and the position (3,) of the right camera [m]."""
        baseline = self._calibration.baseline
        shift = geometry(float(state.mean[DELAY]), twist, baseline).shift
        return expected_fit(state, twist, baseline), np.zeros(3) if shift is None else shift

    def _restarted(
        self, memory: SelfCalibrationMemory[Memory], changed: bool, *, at_once: bool = False
    ) -> SelfCalibrationMemory[Memory]:
        """Memory with its estimate applied; if that or the frame before has changed, the odometry restarts there.

        With ``at_once`` the angles are applied even if they are uncertain.
        """
        applied = memory.applied
        if self._correcting:
            applied = of_rotation(memory.state, applied, at_once=at_once)
        if self._compensating and memory.twist.known:
            applied = of_delay(memory.state, applied)
        another = changed or is_another(applied, memory.applied)
        memory = memory._replace(applied=applied)
        if not another:
            return memory
        odometry = self._odometry.init()  # its memory was of images with the old correction
        for taken in memory.previous:
            then = memory._replace(twist=taken.twist if taken.twist.known else memory.twist)
            odometry, _ = self._odometry.step(odometry, self._corrected(taken.frame, then))
        return memory._replace(odometry=odometry)

    def _corrected(self, frame: StereoFrame, memory: SelfCalibrationMemory[Memory]) -> StereoFrame:
        """Frame with the corrections that are applied."""
        return corrected(
            self._calibration, frame, memory.applied.rotation, pair_geometry(memory, self._calibration.baseline)
        )

    def _stepped(self, memory: SelfCalibrationMemory[Memory], frame: StereoFrame) -> tuple[Memory, Motion | None]:
        """The odometry's memory and motion after the frame with its corrections."""
        return self._odometry.step(memory.odometry, self._corrected(frame, memory))

    def _with_motion(
        self, memory: SelfCalibrationMemory[Memory], frame: StereoFrame, stepped: tuple[Memory, Motion | None]
    ) -> tuple[SelfCalibrationMemory[Memory], Motion | None]:
        """Memory after the odometry's motion to the frame, with the random walk of the mount, and that motion."""
        odometry, motion = stepped
        baseline = self._calibration.baseline
        memory = memory._replace(odometry=odometry)
        taken = Taken(frame, memory.twist, left_over=left_over(memory, baseline))
        if motion is not None and self._is_refuted(memory, motion, frame):
            lost = lost_motion(motion.tick, motion.previous_tick, motion.matches)
            return memory._replace(view=None, previous=(taken,)), lost
        if motion is not None and motion.health is Health.LOST:
            recent = [old for old in memory.previous if frame.tick - old.frame.tick < _LONGEST_LOSS and not old.lost]
            return memory._replace(view=None, previous=(*recent[-1:], taken._replace(lost=True))), motion
        memory = memory._replace(previous=(*memory.previous[-1:], taken))
        if motion is None:
            return memory, motion
        seconds = (motion.tick - motion.previous_tick) * TICK
        turned, p_PC = rotation_vector(motion.X_PC[:3, :3]), motion.X_PC[:3, 3]
        distance = float(np.linalg.norm(p_PC))
        doubt = taken.left_over / baseline + (_ASSUMED if memory.assumed else 0.0)
        memory = memory._replace(
            state=carried(memory.state, distance),
            twist=Twist(turned / seconds, so3_exp(-0.5 * turned) @ p_PC / seconds, doubt),
            fresh=None if memory.fresh is None else memory.fresh + distance,
            earlier=memory.earlier and memory.earlier.after(0.0 if taken.left_over else distance),
            X_VC=chained(memory.X_VC, motion.X_PC),
        )
        return memory, motion

    def _is_refuted(self, memory: SelfCalibrationMemory[Memory], motion: Motion, frame: StereoFrame) -> bool:
        """True if the motion is short, and the ground in the images since the frame before has moved otherwise."""
        if motion.health is Health.LOST or np.linalg.norm(motion.X_PC[:3, 3]) > STANDING:
            return False
        before = next((old.frame for old in memory.previous if old.frame.tick == motion.previous_tick), None)
        return before is not None and ground_contradicts(self._calibration, before.left, frame.left, motion.X_PC)

    def _with_yaw(self, memory: SelfCalibrationMemory[Memory], frame: StereoFrame) -> SelfCalibrationMemory[Memory]:
        """Memory with yaw from the frame and the reference view, and the next distance to look from."""
        state, X_VC, new, view = memory.state, memory.X_VC, memory.state, memory.view
        if view is None:
            return memory
        geometry = pair_geometry(memory, self._calibration.baseline)
        if memory.clipped > _CLIPPED:
            first, second = rematched(self._calibration, view, frame, geometry, X_VC, new.rotation)
            limited = match_clipping(view.image, frame, np.hstack([first.left, second.left]))
            if limited is not None:  # both are clipped where one of them is
                view, frame = view._replace(image=limited[0]), limited[1]
        for _ in range(_REMATCHED):
            last = new.mean[:3]
            pair = rematched(self._calibration, view, frame, geometry, X_VC, new.rotation)
            fit = from_motion(self._calibration, *pair, X_VC, state.mean[:3], state.covariance[:3, :3])
            if fit is None:
                return memory._replace(view=None)
            delay = memory.applied.delay
            twist = memory.twist if delay else UNKNOWN  # most pairs are simultaneous
            new, X_VC = with_information(state, fit.information, fit.gradient, twist, delay), fit.X_PC
            if (np.abs(new.mean[:3] - last) < _SETTLED * new.std[:3]).all():
                break
        return looked(memory._replace(state=new, X_VC=X_VC))

    def _with_view(self, memory: SelfCalibrationMemory[Memory], frame: StereoFrame) -> SelfCalibrationMemory[Memory]:
        """Memory with the frame as its reference view."""
        rng = np.random.default_rng([self._seed, frame.tick, 2])
        doubt = float(memory.state.std[:3].max())
        view = new_view(
            self._calibration,
            frame,
            pair_geometry(memory, self._calibration.baseline),
            memory.state.rotation,
            doubt,
            rng,
            clipped=memory.clipped > _CLIPPED,
        )
        seen = view if len(view.left) >= FEWEST else None
        look = _FIRST_LOOK_IN_DOUBT if _in_doubt(memory.state) else _FIRST_LOOK
        return memory._replace(view=seen, X_VC=np.eye(4), look=look, rest=0.0)

    def _message(self, motion: Motion, memory: SelfCalibrationMemory[Memory]) -> SelfCalibratedMotion:
        """Motion message with what is known of the calibration; of its two pairs the worse one counts."""
        starts = (old.left_over for old in memory.previous if old.frame.tick == motion.previous_tick)
        speed = float(np.linalg.norm(memory.twist.velocity))
        shift = max(left_over(memory, self._calibration.baseline), *starts, 0.0)
        correcting = self._correcting
        doubts = doubt(self._calibration, memory.state, memory.applied, speed, shift, correcting=correcting)
        return with_calibration(self._calibration, motion, memory.state, doubts)
