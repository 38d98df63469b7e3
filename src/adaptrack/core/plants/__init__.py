"""Plants: what is driven. One file a member; `contract` says what a plant is to the loop."""
