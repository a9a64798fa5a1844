/* An ATmega in simavr: what the self-check finds goes to the serial port; sleep without interrupts ends the simulation. */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>

unsigned CHECK(void);

static void put(char c)
{
    while ((UCSR0A & (1 << UDRE0)) == 0) {
    }
    UDR0 = (unsigned char)c;
}

int main(void)
{
    const char *text = "check ";
    UCSR0B = 1 << TXEN0;
    const unsigned bad = CHECK();
    while (*text != '\0') {
        put(*text++);
    }
    put((char)('0' + bad/10u));
    put((char)('0' + bad%10u));
    put('\n');
    cli();
    sleep_mode();
    return 0;
}
