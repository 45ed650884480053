"""What runs on each arm: equations, arm model, controllers, follower and leader processes."""
