"""Twenty deliberate mistakes: tests must notice `MISTAKES`, `crosscheck regress` must notice `BREAKS`.

A mistake belongs here only if no operator of a mutation tool makes the same change: a convention of frames
or quaternions, an erratum of the paper, another run's results, a verdict that excuses all, a 1e-6 change.
"""

MISTAKES = {
    "swapped hinges of a universal joint in the tree": (
        "newton_euler/model/joint_kinds.py",
        'Motion("hinge", self.axis_on_first), Motion("hinge", self.axis_on_second)',
        'Motion("hinge", self.axis_on_second), Motion("hinge", self.axis_on_first)',
        "newton_euler/equations/test_systems.py",
    ),
    "inertia left in the body's frame": (
        "newton_euler/equations/relative.py",
        "return symmetric(a @ self.inertias[body] @ a.T)",
        "return self.inertias[body]",
        "newton_euler/equations/test_systems.py",
    ),
    "inertia of a URDF in the wrong frame": (
        "urdf/write.py",
        "turned = rotation @ body.inertia @ rotation.T",
        "turned = rotation.T @ body.inertia @ rotation",
        "urdf/test_urdf_write.py",
    ),
    "a transposed rotation": (
        "newton_euler/model/euler_parameters.py",
        "return matrix_g(p) @ matrix_l(p).T",
        "return matrix_l(p) @ matrix_g(p).T",
        "newton_euler/model/test_euler_parameters.py",
    ),
    "MuJoCo's quaternions read w-last": (
        "mjcf/model.py",
        "self.data.xquat[bodies]",
        "np.roll(self.data.xquat[bodies], -1, axis=1)",
        "newton_euler/equations/test_systems.py",
    ),
    "Pinocchio's quaternions written w-first": (
        "urdf/model.py",
        "columns = np.roll(columns, -1)",
        "columns = np.roll(columns, 0)",
        "newton_euler/equations/test_systems.py",
    ),
    "Baumgarte's gains swapped, erratum 1": (
        "newton_euler/equations/formulation.py",
        "self.K_D, self.K_P = 2.0 * alpha, alpha * alpha",
        "self.K_P, self.K_D = 2.0 * alpha, alpha * alpha",
        "newton_euler/equations/test_formulations.py",
    ),
    "Euler parameters left to drift, erratum 11": (
        "newton_euler/equations/cartesian.py",
        "-self.c(qdot) - self.K_D * (P @ qdot) - self.K_P * self.norms(q)",
        "-self.c(qdot)",
        "newton_euler/equations/test_formulations.py",
    ),
    "an own error that excuses anything": (
        "crosscheck/compare/run_checks.py",
        "min(ERROR_PER_CHANGE * change, MAX_RELATIVE_ERROR * unit)",
        "ERROR_PER_CHANGE * change",
        "crosscheck/compare/test_unconverged.py",
    ),
    "a check of NaN agrees": (
        "crosscheck/compare/check.py",
        "bool(self.value <= self.tolerance)",
        "not self.value > self.tolerance",
        "crosscheck/compare/test_compare.py::test_a_check_without_a_verdict_agrees",
    ),
    "a baseline compared with itself": (
        "crosscheck/regress/compare.py",
        "_check(quantity, now.get(quantity.name), problem, reported)",
        "_check(quantity, quantity, problem, reported)",
        "crosscheck/regress/test_regress.py::test_a_quantity_moves_where_it_leaves_its_tolerance",
    ),
    "the program of a scene with other numbers": (
        "newton_euler/codegen/fingerprint.py",
        "yield value.tobytes()",
        "yield b''",
        "newton_euler/codegen/test_fingerprint.py::test_whatever_changes_the_equations_changes_it",
    ),
    "the code of the same scene with other gains": (
        "newton_euler/runs/simulate.py",
        "_compiled(scene, formulation, stabilization, baumgarte_alpha(stabilization, alpha))",
        '_compiled(scene, formulation, "projection", 0.0)',
        "newton_euler/runs/test_simulate.py::test_drift_is_bounded_with_baumgarte_and_grows_without",
    ),
    "a held force that outlives its run": (
        "newton_euler/runs/intervals.py",
        "changed = copy.copy(system)",
        "changed = system",
        "newton_euler/runs/test_sampled.py::test_a_run_leaves_the_system_as_it_was",
    ),
    "a batch whose runs start from the first state": (
        "newton_euler/compiled/lanes.py",
        "ends, states = runs.starts[numbers],",
        "ends, states = runs.starts[numbers - numbers],",
        "newton_euler/runs/test_batch.py::test_runs_are_those_one_by_one",
    ),
    "an element left out that is reported as carried over": (
        "newton_euler/reading/import_report.py",
        '            "left out",\n',
        '            "exactly",\n',
        "mjcf/test_mjcf_read.py::test_what_is_left_out",
    ),
}
"""File, what is there, what is made of it, and the tests that see it: a file or a function."""

BREAKS = {
    "a gyroscopic torque off by 1e-6": (
        "newton_euler/equations/relative.py",
        "inertia @ angular[body] + cross(omega, inertia @ omega)",
        "inertia @ angular[body] + (1.0 + 1e-6) * cross(omega, inertia @ omega)",
        "free_top",
    ),
    "gamma off by 1e-6": (
        "newton_euler/model/constraints.py",
        "return cross(omega, cross(omega, s))",
        "return (1.0 + 1e-6) * cross(omega, cross(omega, s))",
        "pendulum",
    ),
    "the tenth digit of a coefficient of DOP853": (
        "newton_euler/integrators/dop853_tableau.py",
        "27.94888452941996",
        "27.94888453941996",
        "pendulum",
    ),
    "a projection that leaves joints open by 1e-6": (
        "newton_euler/integrators/dense_projection.py",
        "RESIDUAL_ROUND_OFF = 16.0 * np.finfo(float).eps",
        "RESIDUAL_ROUND_OFF = 1e-6",
        "pendulum",
    ),
}
"""Small mistakes for `crosscheck regress`: file, right line, wrong line, and the scene that shows it."""
