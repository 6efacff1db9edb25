"""Parameters of a quadrotor's flight and of its information fields."""

import math
from typing import NamedTuple

import numpy as np

from jaxplore._types import ArrayLike, Vector
from jaxplore._xla import compute
from jaxplore.control.mppi import MPPI
from jaxplore.control.noise import Noise
from jaxplore.control.parameterisations import Parameterisation
from jaxplore.control.proposals import Proposal
from jaxplore.control.weighting import Weighting
from jaxplore.costs.base import Cost
from jaxplore.costs.bounds import SpeedLimitCost
from jaxplore.costs.effort import QuadraticControlCost
from jaxplore.costs.obstacles import ObstacleCost
from jaxplore.costs.tracking import StateCost
from jaxplore.dynamics.base import Dynamics
from jaxplore.information.field_sensor import FieldSensor
from jaxplore.information.gain import CellSensor
from jaxplore.information.local_field import LocalFieldSensor
from jaxplore.information.noise import GaussianNoise
from jaxplore.information.pose import PoseInformation
from jaxplore.planning.presets.sampling import Sampling, sampling
from jaxplore.planning.strategy.informative import ShortRangeField
from jaxplore.sensing.lidar import Lidar


class Flight(NamedTuple):
    """Sampling and safety parameters that all controllers of a comparison share.

    The cost of a rollout is the mean over its steps, so the temperature is in units of the cost of
    one step, for any horizon.

    Args:
        horizon: model steps ahead, T.
        num_samples: rollouts, K.
        temperature: temperature of the softmax; the least one of the adaptive softmax.
        noise_std: (nu,) standard deviations of the controls; when absent 5 % of the range of the
            first and 3 % of the range of the others for a robot that flies (2 N and 0.6 rad/s for
            the default quadrotor), and half the range between the bounds for a robot on the ground.
            With P `Knots`, each of which lasts for T / P steps, `std sqrt(P / T)`, which spreads
            the sum of the controls as much. With `Smooth`, whose rates add up from command to
            command, `std / (dt sqrt(T / 2))`: as much after T / 2 commands.
        dt: model step [s].
        control_period: time between commands [s].
        parameterisation: parameterisation of the controls, or its name: direct, smooth or knots
            (splines through 8 knots).
        noise: source of noise, or its name: gaussian, coloured (pink), sobol or bank. New
            numbers take half of the time of a quadrotor's command; a bank has stored ones.
        weighting: weighting of the rollouts, or its name: softmax, adaptive or elite. When absent,
            softmax around a reference (`two-layer`, `sequential`), and adaptive without one.
        effective_share: share of the samples that count: the least one of the adaptive softmax,
            that of the elite.
        altitude: z to keep, for robots that have one [m].
        max_speed: greatest speed without a cost [m/s].
        clearance: distance kept from obstacles [m].
        obstacle_weight: weight of `ObstacleCost`.
        height_weight: weight of the squared error of z.
        speed_weight: weight of `SpeedLimitCost`.
        control_weight: weight of the squared difference of the controls from the default control.
    """

    horizon: int = 40
    num_samples: int = 1000
    temperature: ArrayLike = 0.1
    noise_std: Vector | None = None
    dt: ArrayLike = 0.05
    control_period: ArrayLike = 0.02
    parameterisation: Parameterisation | str = "direct"
    noise: Noise | str = "bank"
    weighting: Weighting | str | None = None
    effective_share: ArrayLike = 0.01
    altitude: ArrayLike = -2.0
    max_speed: ArrayLike = 2.0
    clearance: ArrayLike = 0.6
    obstacle_weight: ArrayLike = 20.0
    height_weight: ArrayLike = 10.0
    speed_weight: ArrayLike = 10.0
    control_weight: ArrayLike = 0.01

    def cost(self, robot: Dynamics) -> Cost:
        """Build the safety costs of a robot."""
        total: Cost = (
            self.obstacle_weight * ObstacleCost(self.clearance)
            + self.speed_weight * SpeedLimitCost(self.max_speed)
            + self.control_weight * QuadraticControlCost(np.ones(robot.control_size))
        )
        if "z" in robot.state_names:
            total = total + self.height_weight * StateCost({"z": 1.0}, {"z": self.altitude})
        return total

    def sampling(self, robot: Dynamics) -> Sampling:
        """Build the parts of MPPI: a Gaussian proposal around the last solution, the
        parameterisation and the weighting.

        Raises:
            ValueError: a horizon, a model step or a standard deviation that is not positive, an
                unknown name.
        """
        std: Vector
        if self.noise_std is None and "z" not in robot.state_names:
            # What a robot on the ground does wrong can be made good: `explorer` has as much noise.
            std = robot.control_half_range
        elif self.noise_std is None:
            share = np.full(robot.control_size, 0.03, np.float32)
            share[0] = 0.05
            bounds = robot.control_min, robot.control_max
            std = compute(lambda _, share, low, high: share * (high - low), share, *bounds)
        else:
            std = self.noise_std
        return sampling(
            std,
            horizon=self.horizon,
            num_samples=self.num_samples,
            dt=self.dt,
            parameterisation=self.parameterisation,
            noise=self.noise,
            weighting="adaptive" if self.weighting is None else self.weighting,
            temperature=self.temperature,
            effective_share=self.effective_share,
            # The control cost that the likelihood ratio stands for keeps a quadrotor near hovering.
            importance=1.0,
        )

    def mppi(self, robot: Dynamics, cost: Cost, proposal: Proposal | None = None) -> MPPI:
        """Build MPPI with these parameters, and with a proposal of one's own if it is given."""
        # Without a reference one of a thousand samples would decide, and a robot at its goal would
        # not come to rest. Around a reference more than that are good.
        is_free = proposal is None or self.weighting is not None
        parts = (self if is_free else self._replace(weighting="softmax")).sampling(robot)
        return MPPI(
            robot,
            (1.0 / self.horizon) * cost,
            horizon=self.horizon,
            num_samples=self.num_samples,
            dt=self.dt,
            control_period=self.control_period,
            proposal=parts.proposal if proposal is None else proposal,
            parameterisation=parts.parameterisation,
            weighting=parts.weighting,
        )


class FieldNumbers(NamedTuple):
    """Parameters of the information fields of informative MPPI.

    Args:
        field_of_view: field of view of both sensors [rad].
        field_beams: beams of the long-range scan that the field around the robot evaluates.
        field_range: range of these beams [m].
        field_noise: standard deviation of their range [m]; the noise is cut off at 3 of them.
        field_spacing: distance between nodes [m].
        field_extent: half the side of the field [m].
        field_headings: number of headings that are evaluated.
        field_period: time between updates of the strategic layer [s].
        local_beams: beams of the short-range scan (Uniform-FSMI).
        local_range: range of these beams [m].
        local_extent: half the side of the window in which short-range scans are evaluated [m]: the
            reach of a rollout. Beyond it their information is 0.
    """

    field_of_view: float = math.pi / 2.0
    field_beams: int = 12
    field_range: float = 10.0
    field_noise: float = 0.1
    field_spacing: float = 0.5
    field_extent: float = 5.0
    field_headings: int = 8
    field_period: ArrayLike = 0.2
    local_beams: int = 6
    local_range: float = 2.5
    local_extent: float = 4.0

    def sensor(self, model: CellSensor, resolution: float) -> LocalFieldSensor:
        """Build the sensor of the field around the robot."""
        far = Lidar(self.field_beams, self.field_range, self.field_of_view)
        noise = GaussianNoise(self.field_noise, truncation=3.0) if self.field_noise > 0.0 else None
        return LocalFieldSensor(
            PoseInformation(far, model, noise=noise),
            resolution,
            extent=self.field_extent,
            spacing=self.field_spacing,
            num_headings=self.field_headings,
        )

    def short_range_field(self, resolution: float) -> ShortRangeField:
        """Build the field of short-range scans."""
        near = Lidar(self.local_beams, self.local_range, self.field_of_view)
        # The directions have the spacing of the beams, so that the information of each scan is a
        # plain sum over directions, without interpolation.
        turn = max(1, round(2.0 * math.pi / near.beam_spacing))
        stride = max(1, round(0.2 / resolution))
        nodes = math.ceil(2.0 * self.local_extent / (stride * resolution) / 8.0) * 8
        # A window can only be computed by the method "scan".
        sensor = FieldSensor(near, resolution, turn, stride, method="scan")
        return ShortRangeField(sensor, nodes, 16)
