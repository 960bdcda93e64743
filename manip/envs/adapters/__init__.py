"""Task batches as environments of other libraries."""
