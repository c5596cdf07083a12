"""What runs a scheme: its functions recorded, printed, and compiled."""
