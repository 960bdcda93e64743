"""The gripper's law as a kernel, one thread per environment."""

import warp as wp


@wp.struct
class GripperModel:
    """Members as in `manip.sim.robot_model.Gripper`."""

    actuator: wp.array[int]
    speed: wp.array[float]
    bias: wp.array[float]
    weight: wp.array[float]


@wp.kernel(enable_backward=False)
def drive_gripper(
    gripper: GripperModel,
    action: wp.array2d[float],
    command: wp.array2d[float],
    ctrl: wp.array2d[float],
) -> None:
    """command = clip(command + speed * sign(a), -1, 1), then affine; a is the last."""
    env = wp.tid()
    last = action[env, action.shape[1] - 1]
    for i in range(gripper.actuator.shape[0]):
        moved = command[env, i] + gripper.speed[i] * sign_of(last)
        command[env, i] = wp.clamp(moved, -1.0, 1.0)
        affine = gripper.bias[i] + gripper.weight[i] * command[env, i]
        ctrl[env, gripper.actuator[i]] = affine


@wp.func
def sign_of(number: float) -> float:
    """-1, 0 or 1; 0 for NaN."""
    if number > 0.0:
        return 1.0
    if number < 0.0:
        return -1.0
    return 0.0
