"""Moves a Franka slowly until the guard stops it: python franka_guard.py ROBOT [PORT], with pip install franky-control

franky calls the callback of a motion in every step of the control loop, from a thread beside it, so the robot
decelerates a few milliseconds after an event. Poses of `--pose franka://` are not available meanwhile: the FCI serves
one program.

Source: franky-control 2.0.0, its documentation and its type stubs.
"""

import sys

from receive_guard import GuardEvents

VELOCITY = (0.0, 0.0, -0.01)  # m/s
SECONDS = 5.0


def move_guarded(franky, robot, guard: GuardEvents, velocity=VELOCITY, seconds=SECONDS) -> str:
    """Move with a constant velocity; return why the guard stopped the motion, empty if it did not."""
    if reason := guard.reason():
        return reason
    duration, reasons = franky.Duration(int(1e3 * seconds)), []
    motion = franky.CartesianVelocityMotion(franky.Twist(list(velocity)), duration)

    def check(state, time_step, relative_time, absolute_time, control_signal) -> None:
        if not reasons and (reason := guard.reason()):
            reasons.append(reason)
            robot.move(franky.CartesianVelocityStopMotion(), asynchronous=True)

    motion.register_callback(check)
    robot.move(motion, asynchronous=True)
    robot.join_motion()
    return reasons[0] if reasons else ""


if __name__ == "__main__":
    import franky

    arm = franky.Robot(sys.argv[1])
    arm.relative_dynamics_factor = 0.05
    events = GuardEvents(int(sys.argv[2]) if len(sys.argv) > 2 else 9003)
    print(move_guarded(franky, arm, events) or "the motion is complete")
