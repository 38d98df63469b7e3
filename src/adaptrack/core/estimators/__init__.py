"""Estimators: one file a member; `contract` says what an estimator is to the controller."""
