"""Solvers of strictly convex quadratic programmes, one file a method; `problem` states the problem and its letters.

`factor.factorise` once for as long as E stays, then one of `active_set.active_set` (the exact solution) and
`hildreth.hildreth` (the paper's procedure), and `residual.kkt_residual` says how optimal a pair (x, lam) is.
"""
