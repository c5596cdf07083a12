"""A step in other languages: `kr.code` and `kreisel code` write it as one short file."""
