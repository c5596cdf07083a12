"""What a system states about itself."""
