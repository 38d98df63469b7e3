"""Cars and plants of others, behind the public contracts."""
