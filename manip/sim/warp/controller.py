"""Controller: the control laws of arm and gripper on N environments."""

from typing import Any

import numpy as np
import warp as wp

from manip.sim.scene import Scene
from manip.sim.warp.arm_memory import arm_data, arm_model, law_state, mass_addresses
from manip.sim.warp.gripper_law import GripperModel, drive_gripper
from manip.sim.warp.joint_law import drive_joints, latch_joints
from manip.sim.warp.pose_law import drive_pose, latch_pose

Array = np.ndarray


class Controller:
    """Set ctrl of a mujoco_warp.Data from actions, as the C engine does.

    Attributes:
        state: the law's state, a `LawState`.
        command: [N, k] float32, the gripper's command for each actuator.

    Raises:
        UserError: the scene has two robots.
    """

    def __init__(self, scene: Scene, data: Any) -> None:
        arm, gripper = scene.layout.only_robot("MuJoCo Warp")
        mass = mass_addresses(scene.physics, data, arm.dof)
        self._arm, self._data = arm_model(arm, mass), data
        self._sim = arm_data(data)
        self.state = law_state(arm, data.nworld)
        self._latch = latch_pose if arm.osc else latch_joints
        self._drive = (drive_pose if arm.osc else drive_joints)(len(arm.dof))
        self._gripper = GripperModel()
        self._gripper.actuator = wp.array(gripper.actuator.astype(np.int32), dtype=int)
        for name in ("speed", "bias", "weight"):
            values = getattr(gripper, name).astype(np.float32)
            setattr(self._gripper, name, wp.array(values, dtype=float))
        self.command = wp.zeros((data.nworld, len(gripper.actuator)), dtype=float)

    def latch(self, action: Any) -> None:
        """Begin a control period: set the goal and the gripper's controls.

        action: [N, A] float32 on the device; NaN breaks its own environment.
        """
        inputs = [self._arm, self._sim, self.state, action]
        wp.launch(self._latch, dim=self._data.nworld, inputs=inputs)
        if self.command.shape[1]:
            inputs = [self._gripper, action, self.command, self._data.ctrl]
            wp.launch(drive_gripper, dim=self._data.nworld, inputs=inputs)

    def drive(self) -> None:
        """Set the arm's controls, between step1 and step2."""
        inputs = [self._arm, self._sim, self.state]
        wp.launch(self._drive, dim=self._data.nworld, inputs=inputs)
