"""Places of a rover's wheels, and the loads on them."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from vehicle.tyres import Num


class Footprint(NamedTuple):
    """Places of the wheels in R as shares of the two half sizes; wheels are in mirrored pairs around R's origin."""

    half_length: Num  # x of the foremost wheels [m]
    half_width: Num  # y of the outermost left wheels [m]
    along: tuple[float, ...]  # x of each wheel over the half length, -1 to 1
    across: tuple[float, ...]  # y of each wheel over the half width, -1 to 1

    @property
    def places(self) -> list[tuple[Num, Num]]:
        """x and y of each wheel in R [m]."""
        shares = zip(self.along, self.across, strict=True)
        return [(along * self.half_length, across * self.half_width) for along, across in shares]

    def loads(self, normal: Num, pitch: Num, roll: Num) -> list[Num]:
        """Loads [N] of the wheels from a normal force [N] and its moments [N m] that load the front and the left.

        The normal force and two moments are three equations, too few for four or six loads. All contacts are taken as
        equally stiff. Under a rigid body the loads are then linear in place, N_k = N/n + A x_k + B y_k. Of all loads in
        balance these have the least elastic energy, the least sum of N_k^2. For mirrored pairs around the origin the
        sums of x_k, y_k and x_k y_k vanish, so A = pitch / sum x_k^2 and B = roll / sum y_k^2.

        A load that would be negative is 0. From there on, far beyond the slopes of any sand, loads do not balance.
        """
        forward = pitch / (self.half_length * sum(along**2 for along in self.along))
        leftward = roll / (self.half_width * sum(across**2 for across in self.across))
        share = normal / len(self.along)
        return [
            ca.fmax(share + along * forward + across * leftward, 0.0)
            for along, across in zip(self.along, self.across, strict=True)
        ]
