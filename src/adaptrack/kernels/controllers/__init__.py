"""Controllers: the MPC, and laws behind one signature; one file a member."""
