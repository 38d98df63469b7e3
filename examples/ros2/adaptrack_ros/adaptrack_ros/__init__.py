"""adaptrack's tracker as a ROS 2 node. `messages`, `follower` and `stand_in` need no ROS; `*_node` are thin shells."""
