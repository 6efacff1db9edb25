"""Which odometry a robot of the settings has."""

import pytest

from jaxplore.localisation import InertialOdometry, Odometry
from jaxplore.localisation.odometry_model import OdometryModel
from jaxplore.parts.localisation.settings import make_localisation
from jaxplore.tasks.registry import make_settings
from jaxplore.tasks.robot import build_sensors


def odometry(model: str, **localisation) -> OdometryModel:
    settings = make_settings(
        {"map": "office", "robot": {"model": model}, "localisation": localisation}
    )
    given = settings.localisation, settings.robot.model, build_sensors(settings)[0], 0.1
    found = make_localisation(*given, is_map_known=True)
    assert found.odometry is found.localiser.expected_odometry
    return found.odometry


@pytest.mark.parametrize(
    ("model", "kind"),
    [("quadrotor", InertialOdometry), ("differential_drive", Odometry), ("ackermann", Odometry)],
)
@pytest.mark.parametrize("method", ["matching", "particles"])
def test_a_quadrotor_has_an_imu_and_a_robot_on_the_ground_wheels(
    model: str, kind: type[OdometryModel], method: str
) -> None:
    assert type(odometry(model, method=method)) is kind
    assert type(odometry(model, method=method, odometry="wheels")) is Odometry
    assert type(odometry(model, method=method, odometry="imu")) is InertialOdometry


def test_the_numbers_are_those_of_the_settings() -> None:
    found = odometry("quadrotor", acceleration_bias=0.1, gyro_noise=0.01, bias_time=5.0)
    assert isinstance(found, InertialOdometry)
    numbers = found.acceleration_bias, found.gyro_noise, found.bias_time
    assert [float(each) for each in numbers] == pytest.approx([0.1, 0.01, 5.0])
    assert found.gyro_bias == InertialOdometry().gyro_bias
    # Plans that know the uncertainty count the variance of a metre at a metre a second.
    assert float(found.variance_per_metre) == pytest.approx(0.02**2 / 3 + 0.1**2 / 4)
    assert float(odometry("ackermann").variance_per_metre) == pytest.approx(0.02**2)
