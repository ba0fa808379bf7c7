"""Online self-calibration: an odometry with an estimate of the right camera's rotation and delay around it.

A mount bent by a tenth of a degree biases the off-tracking by decimetres (de Saxe 2018, section 4.3); a right camera
that exposes 10 ms late does so at 20 km/h. Both are estimated continuously: from the rows of every single pair, and yaw
from pairs some metres apart. The right image is corrected before the odometry: by a homography for rotations (eqs 8 and
9), point by point for the distance travelled over the delay (``estimators.displaced_right``). A pair that contradicts
the estimate is lost; if the next one does too, mount or clock have changed, and the estimate starts anew from it.

Without correction (``correcting=False``) rotations are only watched: motions of a pair whose calibration is refuted are
degraded, with the error in their covariance, or lost. The delay is compensated in any case.

Not modelled: rotation of the left camera (to first order equivalent), translation of the cameras, and the part of a
delay's displacement that is along the baseline while the velocity along the optical axis is too small to show it.

de Saxe 2018: C. de Saxe, D. Cebon, "Estimation of trailer off-tracking using visual odometry", Vehicle System
Dynamics, 2018.
"""

from __future__ import annotations

from typing import Generic, NamedTuple

import numpy as np

from estimators.calibration.corrections import NONE, Corrections, corrected, of_delay, of_rotation
from estimators.calibration.epipolar import EpipolarFit, epipolar_fit
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
    is_surprising,
    reopened,
    with_fit,
    with_information,
)
from estimators.calibration.rotation_fit import from_motion
from estimators.calibration.rotation_views import FEWEST, View, new_view, rematched
from estimators.calibration.self_calibrated_motion import SelfCalibratedMotion, doubt, with_calibration
from estimators.estimates import Health, Motion, lost_motion
from estimators.odometry.circular import CircularOdometry
from estimators.odometry.exposure import alike
from estimators.odometry.keyframe import KeyframeOdometry
from estimators.protocol import Memory, Odometry
from estimators.rigid_motion import chained, rotation_vector
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame
from vehicle.clock import TICK
from vehicle.frames import FloatArray

# Distances from the reference view at which yaw is measured: the first one, and then the double of the last. An early
# coarse value is better than a late fine one, but errors of lenses matter less from afar [m].
_FIRST_LOOK, _FIRST_LOOK_IN_DOUBT = 4.0, 0.9
_APART = 10.0  # distance beyond which a new reference view is taken: views share too few points [m]
_DOUBT = np.radians(0.01)  # of yaw, 1 sigma: more counts as uncertain and costs 6 mm of off-tracking [rad]
_TURNED = np.radians(15.0)  # the same for the rotation between two views
_REMATCHED = 3  # rounds of matching and fitting, each from the result of the one before
_SETTLED = 1.0  # change of the angles after which no more round is needed [standard deviations]
_SHIFTED = 0.015  # displacement of the right camera that is beyond errors of lenses [m]
_SHIFTED_SHARE = 0.05  # the same, as a share of the displacement that is compensated
_SIGNIFICANT = 8.0  # the same in standard deviations of a fit, which are half of the real ones
_ASSUMED = 0.15  # relative error of a velocity with the displacement along the optical axis alone compensated, 1 sigma
_LONGEST_LOSS = 500  # older frames are not returned to for a restart [ticks]


class SelfCalibrationMemory(NamedTuple, Generic[Memory]):
    """Memory of the odometry, the estimate, and the reference view."""

    odometry: Memory
    state: MountState
    applied: Corrections = NONE
    twist: Twist = UNKNOWN
    fresh: float | None = None  # distance since the last fit to a single pair [m]; None: there is none
    previous: tuple[StereoFrame, ...] = ()  # newest frames of the odometry as they came, oldest first
    suspect: StereoFrame | None = None  # newest frame, if it contradicts the estimate
    shift: float = 0.0  # displacement of the right camera along the optical axis, by the newest frame [m]
    assumed: float = 0.0  # the same for the first motion, as long as no velocity relates it to a delay [m]
    view: View | None = None
    X_VC: FloatArray = np.eye(4)  # of the newest frame in the view
    look: float = 0.0  # distance from the view at which yaw is measured next [m]


class SelfCalibratedOdometry(Generic[Memory]):
    """Odometry on corrected images, with self-calibration around it."""

    def __init__(
        self, calibration: StereoCalibration, odometry: Odometry[Memory], *, seed: int = 0, correcting: bool = True
    ) -> None:
        """Self-calibration around an odometry; ``seed`` and a frame's tick fix all random draws.

        With ``correcting=False`` rotations of the right camera are watched, not corrected. Odometries that do not know
        displaced pairs (``estimators.displaced_right``) are lost or degraded while the right camera exposes late.
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
        frame = alike(self._calibration, frame)
        memory, changed = self._with_fit(memory, frame)
        if memory.suspect is frame:
            return memory, self._message(lost_motion(frame.tick, memory.previous[-1].tick), memory)
        start = self._restarted(memory, changed)
        after, motion = self._moved(start, frame)
        if motion is None:
            return self._with_view(after, frame), None
        if motion.health is not Health.LOST and _view_due(after):
            after = self._with_yaw(after, frame)
            again = self._restarted(start._replace(state=after.state), False)
            if again.applied != start.applied:  # the motion once more, with the better correction
                after, motion = self._moved(again._replace(X_VC=after.X_VC, look=after.look), frame)
        if motion is None or after.assumed:
            motion = lost_motion(frame.tick, memory.previous[-1].tick)
        if after.view is None or after.look > _APART:
            after = self._with_view(after, frame)
        message = self._message(motion, after)
        return after._replace(assumed=0.0), message

    def _with_fit(
        self, memory: SelfCalibrationMemory[Memory], frame: StereoFrame
    ) -> tuple[SelfCalibrationMemory[Memory], bool]:
        """Memory with the rows of a frame in its estimate; True if the odometry must restart before it.

        A frame that contradicts the estimate becomes the suspect; after a second one the estimate starts anew there.
        """
        fit, baseline, changed = self._fit(memory, frame), self._calibration.baseline, False
        if fit is None:
            return memory._replace(suspect=None, shift=0.0), False
        innovated = innovation(memory.state, fit, memory.twist, baseline)
        if memory.previous and is_surprising(memory.state, innovated):
            if memory.suspect is None:
                return memory._replace(suspect=frame), False
            memory = memory._replace(state=reopened(memory.state), fresh=None, view=None, previous=(memory.suspect,))
            innovated, changed = innovation(memory.state, fit, memory.twist, baseline), True
        state, shift = with_fit(memory.state, innovated, memory.fresh), _shift(fit)
        memory = memory._replace(state=state, fresh=0.0, suspect=None, shift=shift)
        if shift and not memory.twist.known and self._compensating:
            memory, changed = memory._replace(assumed=shift), True
        return memory, changed

    def _fit(self, memory: SelfCalibrationMemory[Memory], frame: StereoFrame) -> EpipolarFit | None:
        """Fit to the single pair, from what is expected of it."""
        baseline = self._calibration.baseline
        shift = geometry(float(memory.state.mean[DELAY]), memory.twist, baseline).shift
        guess = expected_fit(memory.state, memory.twist, baseline)
        return epipolar_fit(self._calibration, frame, guess, np.zeros(3) if shift is None else shift)

    def _geometry(self, memory: SelfCalibrationMemory[Memory]) -> PairGeometry:
        """Geometry of the corrected pairs; before the first motion, a displacement along the optical axis at most."""
        if memory.assumed:
            return PairGeometry(np.eye(3), np.array([0.0, 0.0, memory.assumed]))
        return geometry(memory.applied.delay, memory.twist, self._calibration.baseline)

    def _restarted(self, memory: SelfCalibrationMemory[Memory], changed: bool) -> SelfCalibrationMemory[Memory]:
        """Memory with its estimate applied; if that or the frame before has changed, the odometry restarts there."""
        applied = of_rotation(memory.state, memory.applied) if self._correcting else memory.applied
        if self._compensating and memory.twist.known:
            applied = of_delay(memory.state, applied)
        if applied == memory.applied and not changed:
            return memory
        memory = memory._replace(applied=applied)
        odometry = self._odometry.init()  # its memory was of images with the old correction
        for frame in memory.previous:
            odometry, _ = self._odometry.step(odometry, self._corrected(frame, memory))
        return memory._replace(odometry=odometry)

    def _corrected(self, frame: StereoFrame, memory: SelfCalibrationMemory[Memory]) -> StereoFrame:
        """Frame with the corrections that are applied."""
        return corrected(self._calibration, frame, memory.applied.rotation, self._geometry(memory))

    def _moved(
        self, memory: SelfCalibrationMemory[Memory], frame: StereoFrame
    ) -> tuple[SelfCalibrationMemory[Memory], Motion | None]:
        """Memory after the odometry's motion to the frame, with the random walk of the mount, and that motion."""
        odometry, motion = self._odometry.step(memory.odometry, self._corrected(frame, memory))
        memory = memory._replace(odometry=odometry)
        if motion is not None and motion.health is Health.LOST:
            recent = [old for old in memory.previous if frame.tick - old.tick < _LONGEST_LOSS]
            return memory._replace(view=None, previous=tuple(recent) or (frame,)), motion
        memory = memory._replace(previous=(*memory.previous[-1:], frame))
        if motion is None:
            return memory, motion
        state, seconds = memory.state, (motion.tick - motion.previous_tick) * TICK
        R_PC, p_PC = motion.X_PC[:3, :3], motion.X_PC[:3, 3]
        distance = float(np.linalg.norm(p_PC))
        doubt = abs(self._left_over(memory)) / self._calibration.baseline + (_ASSUMED if memory.assumed else 0.0)
        memory = memory._replace(
            state=carried(state, distance),
            twist=Twist(rotation_vector(R_PC) / seconds, R_PC.T @ p_PC / seconds, doubt),
            fresh=None if memory.fresh is None else memory.fresh + distance,
            X_VC=chained(memory.X_VC, motion.X_PC),
        )
        return memory, motion

    def _with_yaw(self, memory: SelfCalibrationMemory[Memory], frame: StereoFrame) -> SelfCalibrationMemory[Memory]:
        """Memory with yaw from the frame and the reference view, and the next distance to look from."""
        state, X_VC, new = memory.state, memory.X_VC, memory.state
        if memory.view is None:
            return memory
        for _ in range(_REMATCHED):
            last = new.mean[:3]
            pair = rematched(self._calibration, memory.view, frame, self._geometry(memory), X_VC, new.rotation)
            fit = from_motion(self._calibration, *pair, X_VC, state.mean[:3], state.covariance[:3, :3])
            if fit is None:
                return memory._replace(view=None)
            new, X_VC = with_information(state, fit.information, fit.gradient), fit.X_PC
            if (np.abs(new.mean[:3] - last) < _SETTLED * new.std[:3]).all():
                break
        look = 2.0 * float(np.linalg.norm(X_VC[:3, 3]))
        return memory._replace(state=new, X_VC=X_VC, look=look)

    def _with_view(self, memory: SelfCalibrationMemory[Memory], frame: StereoFrame) -> SelfCalibrationMemory[Memory]:
        """Memory with the frame as its reference view."""
        rng = np.random.default_rng([self._seed, frame.tick, 2])
        doubt = float(memory.state.std[:3].max())
        view = new_view(self._calibration, frame, self._geometry(memory), memory.state.rotation, doubt, rng)
        look = _FIRST_LOOK_IN_DOUBT if memory.state.covariance[YAW, YAW] > _DOUBT**2 else _FIRST_LOOK
        return memory._replace(view=view if len(view.left) >= FEWEST else None, X_VC=np.eye(4), look=look)

    def _message(self, motion: Motion, memory: SelfCalibrationMemory[Memory]) -> SelfCalibratedMotion:
        """Motion message with what is known of the calibration."""
        speed, left_over = float(np.linalg.norm(memory.twist.velocity)), self._left_over(memory)
        correcting = self._correcting
        doubts = doubt(self._calibration, memory.state, memory.applied, speed, left_over, correcting=correcting)
        return with_calibration(self._calibration, motion, memory.state, doubts)

    def _left_over(self, memory: SelfCalibrationMemory[Memory]) -> float:
        """Displacement [m] of the newest right camera that is not compensated; 0 if it is not significant."""
        applied = self._geometry(memory).shift
        compensated = 0.0 if applied is None else float(applied[2])
        left_over = abs(memory.shift - compensated) if memory.shift else 0.0
        return left_over if left_over > max(_SHIFTED, _SHIFTED_SHARE * abs(compensated)) else 0.0


def _shift(fit: EpipolarFit) -> float:
    """Displacement [m] of the right camera along the optical axis by a single pair; 0 if it is not significant."""
    shift = float(fit.values[3])
    return shift if abs(shift) > max(_SHIFTED, _SIGNIFICANT * float(np.sqrt(fit.covariance[3, 3]))) else 0.0


def _view_due(memory: SelfCalibrationMemory[Memory]) -> bool:
    """True if the newest frame is far enough from the reference view, or nearly too far rotated."""
    shift, turn = np.linalg.norm(memory.X_VC[:3, 3]), np.linalg.norm(rotation_vector(memory.X_VC[:3, :3]))
    if memory.view is None:
        return False
    return bool(shift > memory.look or (turn > _TURNED and shift > _FIRST_LOOK_IN_DOUBT))
