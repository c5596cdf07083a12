"""A step in other hands: `kr.code` and `kreisel code` write it as one file of C, JavaScript or Julia."""
