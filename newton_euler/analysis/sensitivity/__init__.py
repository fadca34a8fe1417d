"""Derivatives of runs with respect to parameters; `sensitivities` is the public function.

`tangent_starts` differentiates the start, `tangent_run` the run, with the compiled code of `tangent_code`.
"""
