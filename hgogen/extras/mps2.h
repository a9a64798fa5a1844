/* What a program on the board may use; it defines board_main, whose result 0 is success. */
void say(const char *text);
void say_number(const char *text, unsigned value);
unsigned ticks(void);
void paint(void);
unsigned painted_over(void);
int board_main(void);
