"""Identification: parameters of a scene fitted to measured motion; `identify` is the public function.

`measurements` reads and checks columns of measured numbers, `residuals` compares them with simulated runs,
`fit` minimizes the sum of squared residuals, and `noise` estimates standard deviations of the measurements.
"""
