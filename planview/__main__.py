from planview.cli import main

main()
