"""Identification: parameters of a scene fitted to measured motion; `identify` is the entry.

`measurements` reads and checks columns, `residuals` compares them with runs, `fit` minimizes the squares and
`noise` estimates standard deviations.
"""
