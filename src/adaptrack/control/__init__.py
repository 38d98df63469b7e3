"""The readable faces of the controllers' parts: models, estimators, QP solvers, controllers, schedules, the tracker."""
