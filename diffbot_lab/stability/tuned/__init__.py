"""Certificate of the law with braking profiles under a contract of the estimate."""
