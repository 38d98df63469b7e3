"""Prediction models: one file a member; `contract` says what a model is to the controller."""
