"""The term of a weld constraint that MJX lacks, so that all engines solve the same equations.

The second derivative of a weld's error is J qacc + Jdot qvel, and the solver brings it near a
reference aref. C MuJoCo (3.7 and newer) and Warp therefore ask for J qacc = aref - Jdot qvel; MJX
leaves the last term out, and its gripper strays from theirs by 0.3 mm per control step.
"""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from brax import math
from mujoco import mjx

# mujoco's compiled modules come without stubs.
# pyright: reportAttributeAccessIssue=false

WELD_ROWS = slice(0, 6)
"""MJX puts equality constraints first, and the scenes have one: the gripper's weld."""


class WeldTerm:
    """Adds the missing term for the one weld of a model, of a still body to a moving one."""

    def __init__(self, model: mujoco.MjModel) -> None:
        """Look the weld up.

        Raises:
            ValueError: its equality constraints are not one weld, of a mocap body to another.
        """
        body_type = mujoco.mjtObj.mjOBJ_BODY
        if list(model.eq_type) != [mujoco.mjtEq.mjEQ_WELD] or model.eq_objtype[0] != body_type:
            raise ValueError("scene: its equality constraints are not a single weld of bodies")
        still, self._body = int(model.eq_obj1id[0]), int(model.eq_obj2id[0])
        if model.body_mocapid[still] < 0:
            raise ValueError("scene: the first body of its weld is not a mocap body")
        self._still, self._root = still, int(model.body_rootid[self._body])
        self._relative = jnp.asarray(model.eq_data[0, 6:10], jnp.float32)
        self._torque_scale = float(model.eq_data[0, 10])
        self._anchor = jnp.asarray(model.eq_data[0, 0:3], jnp.float32)
        # Which degrees of freedom move the welded body: those of its ancestors and its own.
        moving = np.zeros(model.nv, np.float32)
        body = self._body
        while body:
            first = model.body_dofadr[body]
            moving[first : first + model.body_dofnum[body]] = 1.0
            body = model.body_parentid[body]
        self._moving = jnp.asarray(moving)

    def add(self, data: mjx.Data) -> mjx.Data:
        """Subtract Jdot qvel [6] from the weld's reference acceleration.

        Args:
            data: after `mjx.fwd_position` and `mjx.fwd_velocity`.
        """
        aref = data._impl.efc_aref  # pyright: ignore[reportOptionalMemberAccess]
        aref = aref.at[WELD_ROWS].add(-self.value(data))
        return data.tree_replace({"_impl.efc_aref": aref})  # pyright: ignore[reportReturnType]

    def value(self, data: mjx.Data) -> jax.Array:
        """Jdot qvel [6]: the second derivative of the weld's error while qacc is 0.

        The error is the still body's position less the moving one's [3], and the vector part of
        conj(q) q_still [3], with q' = w q / 2 and q'' = w' q / 2 + w q' / 2 for angular velocity w.
        """
        rotation = data.xmat[self._body]
        # MJX refers spatial velocities to the centre of mass of the whole tree.
        offset = data.xpos[self._body] + rotation @ self._anchor - data.subtree_com[self._root]
        spin, drift = jnp.split(data.cvel[self._body], 2)
        velocity = drift + jnp.cross(spin, offset)
        bias_spin, bias_drift = jnp.split((self._moving * data.qvel) @ data.cdof_dot, 2)
        acceleration = bias_drift + jnp.cross(bias_spin, offset) + jnp.cross(spin, velocity)

        pure = jnp.zeros(1, spin.dtype)
        spin, bias_spin = jnp.concatenate([pure, spin]), jnp.concatenate([pure, bias_spin])
        quaternion = data.xquat[self._body]
        second = (
            math.quat_mul(bias_spin, quaternion)
            + math.quat_mul(spin, 0.5 * math.quat_mul(spin, quaternion))
        ) / 2
        goal = math.quat_mul(data.xquat[self._still], self._relative)
        turning = math.quat_mul(math.quat_inv(second), goal)[1:]
        return jnp.concatenate([-acceleration, self._torque_scale * turning])
